"""The design-time check: what must, and what should, hold of a specification before it is run or changed to.

Errors make a specification unusable; warnings are what its author most likely did not mean. Nothing
here depends on how the specification was written down: problems point by the names of the JSON form.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from fractions import Fraction

from midstride.model import wording
from midstride.model.best import best
from midstride.model.component import (
    ROS_PARAMETERS,
    ComponentSpec,
    Connector,
    InputAlternatives,
    PortRef,
    value_fits,
    value_kind,
)
from midstride.model.component_rules import (
    component_rules,
    container_rules,
    number_problems,
    predicate_problems,
    value_problems,
)
from midstride.model.configuration import Configuration, to_fraction
from midstride.model.contract import (
    DEFAULT_QOS,
    Contract,
    Predicate,
    connector_kind,
    explain,
    format_number,
    satisfies,
)
from midstride.model.diagnosis import Diagnosis
from midstride.model.diagnostics import Problem, SubjectPath
from midstride.model.gate_checks import gate_problems, gated_node_problems, managed_twice
from midstride.model.host_checks import host_rules, placement_problems
from midstride.model.hosts import resource_key
from midstride.model.name_checks import component_names, node_names, specification_names
from midstride.model.respawn_checks import respawn_problems
from midstride.model.rules import attachment_shortfall, normal_guarantee
from midstride.model.specification import Keep, Limit, Node, Order, Specification, structure
from midstride.model.wording import KIND_WORDS


def check_component(component: ComponentSpec) -> tuple[Problem, ...]:
    """The problems of one component alone: names, numbers, ownership, M1, M2, M3."""
    return _sorted([*component_names(component, ()), *component_rules(component, ()), *gate_problems(component, ())])


def check_node(specification: Specification, role: str) -> tuple[Problem, ...]:
    """The problems of one node, without those of its component: names, contracts, parameters."""
    node, path = specification.nodes[role], ("nodes", role)
    placed = placement_problems(specification, node, path)
    return _sorted([*node_names(specification, node, path), *_node_problems(specification, node, path), *placed])


def check(specification: Specification) -> tuple[Problem, ...]:
    """Every independent problem of a specification, errors and warnings, in a stable order."""
    found = specification_names(specification)
    named = not found
    for name, component in specification.components.items():
        found += component_rules(component, ("components", name))
        found += gate_problems(component, ("components", name))
    found += _context_problems(specification)
    for role, node in specification.nodes.items():
        found += _node_problems(specification, node, ("nodes", role))
    found += managed_twice(specification)
    found += _too_many_publishers(specification)
    found += host_rules(specification)
    found += _capacities(specification)
    found += _constraint_problems(specification)
    found += _requirement_problems(specification)
    found += _unsatisfiable(specification)
    if named:
        whole = structure(specification)
        found += _unsatisfied_topics(whole)
        if not errors(found):  # the modes are meaningless before the rest is correct
            found += _at_start(specification, best(whole))
    return _sorted(found)


def errors(problems: Iterable[Problem]) -> list[Problem]:
    """The problems that make a specification unusable."""
    return [problem for problem in problems if problem.severity == "error"]


def _sorted(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    def place(problem: Problem) -> tuple[object, ...]:
        elements = ((0, int(e), "") if e.isdecimal() else (1, 0, e) for e in problem.subject)
        return (*elements, (-1, 0, problem.code), (-1, 0, problem.message))

    return tuple(sorted(dict.fromkeys(problems), key=place))


# -- the context ---------------------------------------------------------------------------------------


def _context_problems(specification: Specification) -> Iterator[Problem]:
    for name, connector in specification.connectors.items():
        path = (f"{connector.kind}s", name)
        yield from predicate_problems(connector.guarantee, path)
        yield from number_problems(
            connector.max_publishers, "the number of publishers", (*path, "max_publishers"), zero=True
        )
    for offer in specification.environment:
        yield from predicate_problems(offer.guarantee, ("environment", offer.name, "guarantee"))
    for name, resource in specification.resources.items():
        yield from number_problems(resource.capacity, f"the capacity of {name}", ("resources", name, "capacity"))
    for name, program in specification.containers.items():
        yield from container_rules(program, ("containers", name))
    for kind, seconds in specification.timing.items():
        what, zero = f"the duration of a step `{kind}`", kind != "state_timeout"
        yield from number_problems(seconds, what if zero else f"`{kind}`", ("timing_seconds", kind), zero=zero)


def _too_many_publishers(specification: Specification) -> Iterator[Problem]:
    publishers: dict[str, list[str]] = {}
    for role, node in sorted(specification.nodes.items()):
        component = specification.components.get(node.component)
        for port, topics in sorted(node.attachments.items()):
            if component is not None and port in component.outputs:
                for topic in dict.fromkeys(topics):
                    publishers.setdefault(topic, []).append(str(PortRef(role, port)))
    for name, connector in specification.connectors.items():
        offers = specification.context.publishers_out_of_scope(connector)
        counted = publishers.get(name, []) + [f"environment {offer.name}" for offer in offers]
        if connector.max_publishers is not None and len(counted) > connector.max_publishers:
            count = wording.counted(len(counted), KIND_WORDS[connector.kind].provider)
            message = f"{name} has {count} ({', '.join(counted)}), at most {connector.max_publishers} allowed"
            if connector.kind == "topic":
                yield Problem("E022", ("topics", name, "max_publishers"), message, "silent publishers count, too")
            else:
                help = "attach only one: every server of a name would answer each request"
                yield Problem("E022", (f"{connector.kind}s", name), message, help)


def _capacities(specification: Specification) -> Iterator[Problem]:
    holders: dict[str, list[tuple[str, float]]] = {}
    for role, node in sorted(specification.nodes.items()):
        component = specification.components.get(node.component)
        for resource, amount in () if component is None else component.resource_usage.items():
            if math.isfinite(amount):
                holders.setdefault(resource_key(resource, node.host), []).append((role, amount))
    for name, declared in specification.resources.items():
        total = sum((to_fraction(amount) for _, amount in holders.get(name, [])), start=Fraction())
        if 0 < declared.capacity < math.inf and total > to_fraction(declared.capacity):
            holding = ", ".join(f"{role} {format_number(amount)}" for role, amount in holders[name])
            held, capacity = format_number(float(total)), format_number(declared.capacity)
            message = f"nodes hold {held} of {name} ({holding}), but its capacity is {capacity}"
            yield Problem("E023", ("resources", name), message, "remove a node that holds it, or raise the capacity")


# -- nodes ---------------------------------------------------------------------------------------------


def _node_problems(specification: Specification, node: Node, path: SubjectPath) -> Iterator[Problem]:
    component = specification.components.get(node.component)
    if component is None:
        return
    for port, topics in node.attachments.items():
        where = (*path, "attachments", port)
        for index, topic in enumerate(topics):
            if topic in topics[:index]:
                message = f"{node.role}.{port} is attached to {topic} twice"
                yield Problem("E021", (*where, str(index)), message, "attach it once")
            elif topic in specification.connectors:
                connector = specification.connectors[topic]
                yield from _unfit(component, PortRef(node.role, port), connector, (*where, str(index)))
    if all(port in component.ports() for port in node.attachments):  # else one of them may be misspelt
        for port in component.ports():
            output = component.has_output(port)
            if not node.attachments.get(port) and not (output and component.find_owner(port) is None):
                words = KIND_WORDS[connector_kind(component.type_of(port) or "")]
                kind = words.output if output else words.input
                message = f"{kind} {node.role}.{port} is attached to no {words.connector}"
                yield Problem("W030", (*path, "attachments", port), message, "attach it, or remove it")
    yield from respawn_problems(specification, node, (*path, "respawn"))
    yield from gated_node_problems(component, node, path)
    for name, value in node.parameters.items():
        yield from value_problems(value, (*path, "parameters", name))
        declared = component.parameters.get(name)
        expected = ROS_PARAMETERS.get(name) if declared is None else declared.value
        if expected is not None and not value_fits(value, expected):
            kinds = f"{value_kind(expected)}, not {value_kind(value)}"
            yield Problem("E025", (*path, "parameters", name), f"parameter {name} of {component.name} takes {kinds}")


def _unfit(component: ComponentSpec, port: PortRef, connector: Connector, path: SubjectPath) -> Iterator[Problem]:
    """The normal mode of an output, or the assumption of an input, must fit the topic, as for the action ``attach``."""
    owner = component.find_owner(port.port)
    if port.port in component.inputs:
        stated: Contract = component.inputs[port.port]
    elif owner is not None and owner.modes:
        stated = normal_guarantee(component, port.port)
    else:
        return
    if any(isinstance(contract, Predicate) and contract.is_empty for contract in (stated, connector.guarantee)):
        return  # reported already
    shortfall, clauses = attachment_shortfall(component, port, connector)
    if clauses:
        message = f"{shortfall}: {', '.join(clauses)}"
        yield Problem("E020", path, message, "strengthen what is offered, or weaken what is needed")


# -- constraints -----------------------------------------------------------------------------------------


def _constraint_problems(specification: Specification) -> Iterator[Problem]:
    """Orders that form a cycle, reported at the one that closes it; negative times."""
    after: dict[str, list[tuple[str, Order]]] = {}
    for index, constraint in enumerate(specification.constraints):
        path = ("constraints", str(index))
        if isinstance(constraint, Limit):
            yield from number_problems(constraint.seconds, "a time", (*path, "below_baseline_seconds"), zero=True)
        elif isinstance(constraint, Order) and constraint.first:
            if constraint.first == constraint.then:
                message = f"`{constraint}`: {constraint.first} cannot come before itself"
                yield Problem("E024", path, message, "remove it")
            elif (cycle := _path(after, constraint.then, constraint.first)) is not None:
                others = ", ".join(f"`{other}`" for other in cycle)
                yield Problem("E024", path, f"`{constraint}` contradicts {others}", "remove one of them")
            else:
                after.setdefault(constraint.first, []).append((constraint.then, constraint))


def _requirement_problems(specification: Specification) -> Iterator[Problem]:
    """Requirements of changes that every message meets, or that state what is not judged."""
    for index, requirement in enumerate(specification.requirements):
        path, assumption = ("changes_require", str(index)), requirement.assumption
        where = (*path, "assumption")
        yield from predicate_problems(assumption, where)
        yield from number_problems(requirement.max_age, "the age of a message", (*path, "max_age_seconds"))
        if assumption.type and not assumption.fields:
            message = (
                f"changes require nothing of {requirement.topic}: no field is constrained, so every message meets it"
            )
            yield Problem("E004", where, message, "add `where …`")
        if assumption.rate is not None:
            message = f"changes are allowed by the last message on {requirement.topic}, so its rate is not judged"
            yield Problem("E004", (*where, "rate"), message, "leave out the rate; `max_age 1 s` bounds its age")
        if assumption.qos != DEFAULT_QOS:
            message = f"the manager listens to {requirement.topic} so that it hears publishers of every QoS"
            yield Problem("E004", (*where, "qos"), message, "leave out the QoS")


def _path(after: dict[str, list[tuple[str, Order]]], start: str, end: str) -> list[Order] | None:
    """A shortest chain of orders that puts ``start`` before ``end``, or None."""
    paths: dict[str, list[Order]] = {start: []}
    waiting = deque([start])
    while waiting:
        role = waiting.popleft()
        if role == end:
            return paths[role]
        for then, order in after.get(role, ()):
            if then not in paths:
                paths[then] = [*paths[role], order]
                waiting.append(then)
    return None


# -- what should hold ------------------------------------------------------------------------------------


def _unsatisfiable(specification: Specification) -> Iterator[Problem]:
    """Assumptions by predicate that neither an associated input nor the environment can satisfy."""
    offers = specification.context.offers()
    for name, component in specification.components.items():
        for functionality in component:
            if any(port not in component.inputs for port in functionality.inputs):
                continue
            for mode in functionality.modes:
                for index, assumption in enumerate(mode.assumptions):
                    if isinstance(assumption, InputAlternatives):
                        continue
                    given = [(component.port_in_words(port), component.inputs[port]) for port in functionality.inputs]
                    given += [(f"environment {offer.name}", offer.guarantee) for offer in offers]
                    if any(satisfies(predicate, assumption) for _, predicate in given):
                        continue
                    alike = ((source, predicate) for source, predicate in given if predicate.type == assumption.type)
                    shortfalls = [f"{source}: {', '.join(explain(each, assumption))}" for source, each in alike]
                    kind = KIND_WORDS[assumption.kind].input
                    nothing = f"no {kind} of {functionality.name} and no environment guarantee has that type"
                    unmet = f"mode {mode.name} of {functionality.name} assumes {assumption}, which nothing can satisfy"
                    where = ("components", name, "functionalities", functionality.name, "modes", mode.name)
                    message = f"{unmet}: {'; '.join(shortfalls) or nothing}"
                    yield Problem("W032", (*where, "assumes", str(index)), message)


def _unsatisfied_topics(configuration: Configuration) -> Iterator[Problem]:
    """Topics without a publisher. An attached output that does not fit the topic is reported as E020."""
    for name, connector in configuration.context.connectors.items():
        offers = configuration.context.publishers_out_of_scope(connector)
        reasons = {offer.name: explain(offer.guarantee, connector.guarantee) for offer in offers}
        if configuration.publishers_on(name) or not all(reasons.values()):
            continue
        shortfalls = "; ".join(f"environment {offer}: {', '.join(clauses)}" for offer, clauses in reasons.items())
        words = KIND_WORDS[connector.kind]
        lacks = f"{name} has no {words.provider}"
        message = f"no {words.provider} satisfies {name}: {shortfalls}" if shortfalls else lacks
        help = f"attach {wording.indefinite(words.output)}, or let the environment guarantee it"
        yield Problem("W031", (f"{connector.kind}s", name), message, help)


def _at_start(specification: Specification, configuration: Configuration) -> Iterator[Problem]:
    """Functionalities that cannot start in their normal mode, and `keep` constraints that do not hold therefore."""
    diagnosis = Diagnosis(configuration)
    for ref in configuration.modes:
        if configuration.modes[ref] > 0:
            reasons = diagnosis.chain(ref)
            path = ("nodes", ref.instance)
            first = reasons[0].replace(" cannot be", " cannot start", 1)
            message = "; ".join([f"{first} (it will start in mode {configuration.mode(ref).name})", *reasons[1:]])
            yield Problem("W033", path, message)
    for index, constraint in enumerate(specification.constraints):
        if isinstance(constraint, Keep):
            ref = constraint.functionality
            if configuration.modes[ref] > configuration.functionality(ref).mode_index(constraint.mode):
                mode = configuration.mode(ref).name
                message = f"`{constraint}` does not hold at the start: {ref} will start in mode {mode}"
                yield Problem("W034", ("constraints", str(index)), message)
