"""From the files of a system to its specification and diagnostics.

Errors specific to the text are found here. :mod:`midstride.model.specification_checks` checks what could be built; its
problems are reported at their places in the text, except those that may only be consequences of a part that could not
be parsed or resolved.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from immutables import Map

from midstride.lang.component_builder import UNRESOLVED, ComponentBuilder
from midstride.lang.contract_builder import ContractResolver
from midstride.lang.declarations import Declarations, collect, host_of, resolve_topic
from midstride.lang.diagnostic_text import Diagnostic, Note, Reporter, in_order
from midstride.lang.hints import Hints, impact
from midstride.lang.lexer import is_topic_name
from midstride.lang.message_types import MessageTypes
from midstride.lang.node_builder import NodeBuilder
from midstride.lang.source import Source, Span
from midstride.lang.source_files import Bounds, FileReader, Loader, resolve_name
from midstride.lang.source_map import SourceMap
from midstride.lang.syntax import HostDeclaration, KeepStatement, OrderStatement, ResourceDeclaration
from midstride.model.component import Connector, EnvironmentGuarantee, FunctionalityRef, Resource
from midstride.model.diagnostics import Problem, suggestion, unknown_name
from midstride.model.hosts import MANAGER, HostSpec
from midstride.model.specification import ChangeRequirement, Constraint, Keep, Limit, Order, Specification, initial
from midstride.model.specification_checks import check as check_specification

# Warnings about the running system, which are meaningless as long as there are errors.
_WITHOUT_ERRORS = frozenset({"W031", "W032", "W033", "W034"})
# Checks of a functionality that need all its contracts, and those that need all its modes.
_NEED_CONTRACTS = frozenset({"E011", "E012", "W032"})
_NEED_MODES = frozenset({"E010", "E011", "E012", "E015", "W032"})
# The statements that declare the entries of these sections of the JSON form.
_PORTS = ("input", "output", "client", "server", "action")
_KEYWORDS = {"inputs": _PORTS, "outputs": _PORTS, "functionalities": ("functionality",), "parameters": ("parameters",)}
# Reported while the text is resolved, at a more precise place.
_CHECKED_HERE = frozenset({"E016"})


@dataclass(frozen=True, slots=True)
class Resolved:
    """The resolved files of a system, for tools that need more than the specification."""

    declarations: Declarations
    components: ComponentBuilder
    contracts: ContractResolver
    specification: Specification


def check_files(
    source: Source, read: FileReader, messages: MessageTypes | None
) -> tuple[Specification | None, tuple[Diagnostic, ...], tuple[Source, ...], Resolved]:
    """Check ``source`` and its includes. Returns the specification (None if there are errors), the diagnostics, the
    sources and the resolved declarations."""
    reporter = Reporter()
    bounds = Bounds.of(source.path or Path(source.name))
    loader = Loader(read, reporter, bounds)
    loader.load(source)
    semantic = reporter
    if loader.files_in_order[0].file.system is None and "system" not in loader.skipped:
        end = len(source.text) - len(source.text.lstrip())
        help = "start the file with `system NAME`; to check a fragment, check the file that includes it"
        reporter.report("E106", Span(source, end, end), "this file does not name a system", help=help)
        semantic = Reporter()  # discarded: what a fragment uses may be declared by the file that includes it
    declarations = collect(loader.files_in_order, semantic)
    skipped = frozenset(loader.skipped)
    contracts = ContractResolver(declarations.contracts, skipped, messages, semantic)
    components = ComponentBuilder(declarations.components, contracts, skipped, semantic)
    contracts.resolve_all()
    nodes = NodeBuilder(declarations, components.build(), components.merged, read, bounds, semantic)
    builder = _SpecificationBuilder(declarations, contracts, components, nodes, skipped, semantic)
    specification = builder.specification()
    builder.report_problems(specification, loader.files_missing)
    reporter.finish(source.name)
    resolved = Resolved(declarations, components, contracts, specification)
    sources = (*loader.sources, *nodes.sources)
    return (None if reporter.has_errors else specification), in_order(reporter.found), sources, resolved


@dataclass(slots=True)
class _SpecificationBuilder:
    declarations: Declarations
    contracts: ContractResolver
    components: ComponentBuilder
    nodes: NodeBuilder
    skipped: frozenset[str]
    reporter: Reporter
    unresolved_topics: set[str] = field(default_factory=set)

    def specification(self) -> Specification:
        """The specification, with placeholders for what could not be resolved."""
        found = self.declarations
        nodes = self.nodes.build()
        return Specification(
            name="" if found.system is None else found.system.text,
            connectors=Map(self._connectors()),
            components=Map(self.nodes.components),
            nodes=Map(nodes),
            environment=tuple(self._offers()),
            resources=Map({key: _resource(declared) for key, declared in found.resources.items()}),
            constraints=tuple(self._constraints()),
            timing=Map({kind: duration.seconds.value for kind, duration in found.timing.items()}),
            requirements=tuple(self._requirements()),
            containers=Map(self.components.containers(found.containers)),
            hosts=Map({name: _host(declared) for name, declared in found.hosts.items()}),
        )

    def _connectors(self) -> dict[str, Connector]:
        connectors: dict[str, Connector] = {}
        for name, topic in self.declarations.topics.items():
            guarantee = self.contracts.predicate(topic.contract, "a topic's contract")
            if topic.contract is not None:
                self.contracts.of_kind(guarantee, topic.kind, topic.contract.span, f"{topic.kind} {topic.name.text}")
            if guarantee is None:
                self.unresolved_topics.add(name)
            max_publishers = None if topic.max_publishers is None else int(topic.max_publishers.value)
            connectors[name] = Connector(name, guarantee or UNRESOLVED, max_publishers)
        return connectors

    def _offers(self) -> Iterator[EnvironmentGuarantee]:
        for name, (namespace, offer) in self.declarations.offers.items():
            guarantee = self.contracts.predicate(offer.contract, "an environment guarantee")
            topic = None if offer.topic is None else resolve_topic(namespace, offer.topic.text)
            yield EnvironmentGuarantee(name, guarantee or UNRESOLVED, topic)

    def _requirements(self) -> Iterator[ChangeRequirement]:
        for namespace, statement in self.declarations.requirements:
            assumption = self.contracts.predicate(statement.contract, "what changes require")
            max_age = None if statement.max_age is None else statement.max_age.value
            topic = resolve_topic(namespace, statement.topic.text)
            yield ChangeRequirement(topic, assumption or UNRESOLVED, max_age, statement.recovery)

    def _constraints(self) -> Iterator[Constraint]:
        for namespace, statement in self.declarations.constraints:
            if isinstance(statement, OrderStatement):
                yield Order(*(resolve_name(namespace, name.text) for name in (statement.first, statement.then)))
                continue
            role, name = statement.functionality
            ref = FunctionalityRef(resolve_name(namespace, role.text), name.text)
            if isinstance(statement, KeepStatement):
                yield Keep(ref, statement.mode.text)
            else:
                yield Limit(ref, statement.seconds.value)

    def report_problems(self, specification: Specification, files_missing: bool) -> None:
        """Report the problems of the specification, except possible consequences of errors already reported."""
        source_map = SourceMap(self.declarations, self.components.merged, self.nodes.parameter_spans)
        has_errors = self.reporter.has_errors
        problems = check_specification(specification)
        only_mismatches = not has_errors and {p.code for p in problems if p.severity == "error"} == {"E020"}
        at_start = initial(specification) if only_mismatches else None
        hints = Hints(specification)
        if not files_missing:
            self._report_unknown_hosts()
        for problem in problems:
            if problem.code in _CHECKED_HERE or (has_errors and problem.code in _WITHOUT_ERRORS) or not problem.subject:
                continue
            if problem.subject == ("system",) and not specification.name:
                continue
            place = source_map.span_of(problem)
            if self._may_follow(problem, specification, files_missing, place):
                continue
            notes: Iterable[Note] = ()
            follows: str | None = None
            if problem.code == "E020":
                notes = self._contracts_of(problem, specification)
                follows = None if at_start is None else impact(problem, specification, at_start)
            help = hints.help_for(problem, "" if place is None else place.text)
            self.reporter.report(problem.code, place, problem.message, help=help, notes=notes, follows=follows)

    def _report_unknown_hosts(self) -> None:
        """Report hosts of namespaces and of included files, also where nothing in them has a host."""
        known = {*self.declarations.hosts, MANAGER}
        for name in self.declarations.around:
            if name.text not in known and name.text not in self.skipped:
                help = suggestion(name.text, known)
                self.reporter.report("E008", name.span, unknown_name("host", name.text), help=help)

    def _contracts_of(self, problem: Problem, specification: Specification) -> list[Note]:
        """The places where the two contracts of an attachment are stated."""
        _, role, _, port, index = problem.subject
        node = specification.nodes[role]
        declaration = self.components.merged[node.component]
        topic = self.declarations.topics[node.attachments[port][int(index)]]
        notes = [Note("contract of the topic", topic.contract.span)] if topic.contract is not None else []
        stated = [i.contract for i in declaration.inputs if i.name.text == port]
        owners = [f for f in declaration.functionalities if any(o.text == port for o in f.produces)]
        stated += [g.contract for f in owners[:1] for g in f.modes[0].guarantees if g.output.text == port]
        return notes + [Note("contract of the port", contract.span) for contract in stated[:1]]

    def _may_follow(
        self, problem: Problem, specification: Specification, files_missing: bool, place: Span | None
    ) -> bool:
        """Return whether a problem may only be a consequence of a part that could not be parsed or resolved."""
        kind, name, *rest = (*problem.subject, "", "")
        if problem.code == "E008":
            text = "" if place is None else place.text
            skipped = text in self.skipped or text.rpartition("/")[2] in self.skipped
            return files_missing or skipped or self._may_be_declared(problem)
        if problem.code == "E006" and place is not None and not is_topic_name(place.text):
            return True  # the lexer has reported it
        if kind == "components":
            unresolved = self.components.unresolved[name]
            if rest and rest[0] == "functionalities":
                of_contracts = problem.code in _NEED_CONTRACTS and rest[1] in unresolved.functionalities
                return of_contracts or (rest[1] in unresolved.incomplete and problem.code in _NEED_MODES)
            return problem.code == "E013" and (unresolved.may_declare("functionality") or bool(unresolved.incomplete))
        if kind == "nodes":
            return self._node_may_follow(problem, specification)
        if kind in {"topics", "services", "actions"} and name in self.unresolved_topics:
            return True
        return problem.code == "W031" and files_missing

    def _may_be_declared(self, problem: Problem) -> bool:
        """Return whether a skipped statement of a component, or an unknown base of it, may declare the name."""
        kind, name, section = (*problem.declared, "", "", "")[:3]
        if kind != "components" or name not in self.components.unresolved:
            return False
        return self.components.unresolved[name].may_declare(*_KEYWORDS.get(section, ()))

    def _node_may_follow(self, problem: Problem, specification: Specification) -> bool:
        role, *rest = problem.subject[1:]
        node = specification.nodes[role]
        unresolved = self.components.unresolved.get(node.component)
        if unresolved is None:
            return False
        if problem.code == "E026":
            fallback = self.components.unresolved.get((node.respawn and node.respawn.fallback) or "", unresolved)
            topics = {topic for attached in node.attachments.values() for topic in attached}
            return bool(unresolved or fallback or topics & self.unresolved_topics)
        if problem.code == "W030":
            return self.declarations.nodes[role].declaration.incomplete or bool(unresolved.skipped) or unresolved.base
        if problem.code == "E020":
            _, port, index = rest
            topic = node.attachments[port][int(index)]
            owner = specification.components[node.component].find_owner(port)
            uncertain = owner is not None and owner.name in unresolved.normal
            return port in unresolved.ports or topic in self.unresolved_topics or uncertain
        return False


def _resource(declared: ResourceDeclaration) -> Resource:
    return Resource(
        declared.name.text, 1.0 if declared.capacity is None else declared.capacity.value, host_of(declared.host)
    )


def _host(declared: HostDeclaration) -> HostSpec:
    name, ssh, setup, folder = (each and each.text for each in declared)
    return HostSpec(name or "", ssh or name or "", setup, folder)
