"""Maps the subjects of the model's problems to places in the text.

A subject is a path in the JSON form (``components``, ``Talker``, ``outputs``, ``0``); its place is the most specific
part of the declaration that the path identifies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from midstride.lang import syntax
from midstride.lang.declarations import Declarations
from midstride.lang.respawn_builder import respawn_span
from midstride.lang.source import Span
from midstride.lang.syntax import find
from midstride.model.diagnostics import Problem

Subject = Sequence[str]


@dataclass(frozen=True, slots=True)
class SourceMap:
    """Finds where the subject of a problem is declared."""

    declarations: Declarations
    merged: Mapping[str, syntax.ComponentDeclaration]
    parameters: Mapping[tuple[str, str], Span]

    def span_of(self, problem: Problem) -> Span | None:
        """The place of a problem's subject; None if the text has none."""
        found = self.declarations
        match problem.subject:
            case ("components", name, *rest) if name in self.merged:
                return _component(self.merged[name], rest)
            case ("nodes", role, *rest) if role in found.nodes:
                return self._node(role, rest)
            case ("topics" | "services" | "actions", name, *rest) if name in found.topics:
                topic = found.topics[name]
                if rest[:1] == ["max_publishers"] and topic.max_publishers is not None:
                    return topic.max_publishers.span
                return _contract(topic.contract, rest, topic.name.span)
            case ("environment", name, *rest) if name in found.offers:
                offer = found.offers[name].declaration
                if rest[:1] == ["topic"] and offer.topic is not None:
                    return offer.topic.span
                return _contract(offer.contract, rest[1:], offer.contract.span if rest else offer.name.span)
            case ("hosts", name, *rest) if name in found.hosts:
                return _host(found.hosts[name], rest)
            case ("resources", name, *rest) if name in found.resources:
                resource = found.resources[name]
                if rest == ["host"] and resource.host is not None:
                    return resource.host.span
                return resource.name.span if resource.capacity is None or not rest else resource.capacity.span
            case ("containers", name, *rest) if name in found.containers:
                return _shared_container(found.containers[name], rest)
            case ("constraints", index, *rest) if _within(found.constraints, index):
                return _constraint(found.constraints[int(index)][1], rest, problem.declared[:1] == ("nodes",))
            case ("changes_require", index, *rest) if _within(found.requirements, index):
                return _requirement(found.requirements[int(index)][1], rest)
            case ("timing_seconds", kind, *_) if kind in found.timing:
                return found.timing[kind].kind.span
        return None if found.system is None else found.system.span

    def _node(self, role: str, rest: Subject) -> Span:
        declaration = self.declarations.nodes[role].declaration
        match rest:
            case ["component", *_] if declaration.component is not None:
                return declaration.component.span
            case ["container"] if declaration.container is not None:
                return declaration.container.span
            case ["host"] if (name := declaration.host or declaration.container or declaration.component) is not None:
                return name.span
            case ["parameters", name, *_]:
                return self.parameters.get((role, name), declaration.name.span)
            case ["respawn", *inner]:
                return respawn_span(declaration.respawn, inner)
            case ["attachments", name, *inner]:
                attachments = [attachment for attachment in declaration.attachments if attachment.port.text == name]
                topics = [topic for attachment in attachments for topic in attachment.topics]
                if attachments:
                    return _nth(topics, inner, attachments[0].port.span)
        return declaration.name.span


def _host(declaration: syntax.HostDeclaration, rest: Subject) -> Span:
    named = {"ssh": declaration.ssh, "setup": declaration.setup, "folder": declaration.folder}
    return (named.get(rest[0] if rest else "") or declaration.name).span


def _shared_container(declaration: syntax.ContainerDeclaration, rest: Subject) -> Span:
    match rest:
        case ["host"] if declaration.host is not None:
            return declaration.host.span
        case ["environment", name] if (variable := find(declaration.environment, name)) is not None:
            return variable.name.span
    run = declaration.run
    return (None if run is None else _of_run(run, rest)) or declaration.name.span


def _constraint(statement: syntax.ConstraintStatement, rest: Subject, of_node: bool) -> Span:
    """``of_node``: the problem is with the node, not with its functionality."""
    match statement, rest:
        case syntax.OrderStatement(), ["order", *_]:
            return statement.first.span
        case syntax.OrderStatement(), ["before", *_]:
            return statement.then.span
        case syntax.KeepStatement() | syntax.LimitStatement(), ["keep" | "limit", *_]:
            return statement.functionality.role.span if of_node else statement.functionality.functionality.span
        case syntax.KeepStatement(), ["at", *_]:
            return statement.mode.span
        case syntax.LimitStatement(), ["below_baseline_seconds", *_]:
            return statement.seconds.span
    return statement.span


def _requirement(statement: syntax.ChangesStatement, rest: Subject) -> Span:
    match rest:
        case ["topic", *_]:
            return statement.topic.span
        case ["max_age_seconds", *_] if statement.max_age is not None:
            return statement.max_age.span
        case ["assumption", *inner]:
            return _contract(statement.contract, inner, statement.contract.span)
    return statement.span


def _of_run(run: syntax.Run, rest: Subject) -> Span | None:
    """The place of a clause of a `run` statement; None where it is not stated."""
    stop, container = run.stop, run.container
    match rest:
        case ["run", *_]:
            return run.command.span
        case ["package", *_] if run.package is not None:
            return run.package.span
        case ["container", "run"] if container is not None and container.program is not None:
            return container.program.span
        case ["container", "package"] if container is not None and container.package is not None:
            return container.package.span
        case ["container", *_] | ["unnamed"]:
            return run.span
        case ["prefix", *_] if run.prefix is not None:
            return run.prefix.span
        case ["takes_seconds"] if run.startup is not None:
            return run.startup.span
        case ["activate_seconds"] if run.activate is not None:
            return run.activate.span
        case ["stop_seconds", name] if stop is not None and (time := getattr(stop, name, None)) is not None:
            return time.span  # type: ignore[no-any-return]
        case ["stop_seconds"] if stop is not None:
            return stop.span
        case ["renames"] if run.renames is not None:
            return run.renames.span
        case ["gate"] if run.gate is not None:
            return run.gate.span
        case ["once", *_] if run.once is not None:
            return run.once
    return None


def _component(declaration: syntax.ComponentDeclaration, rest: Subject) -> Span:
    run = declaration.runs[0] if declaration.runs else None
    if run is not None and (span := _of_run(run, rest)) is not None:
        return span
    match rest:
        case ["environment", name] if (variable := find(declaration.environment, name)) is not None:
            return variable.name.span
        case ["lazy", name] if output := next((each for each in declaration.lazy if each.text == name), None):
            return output.span
        case ["topics", name] if (own := find(declaration.topics, name)) is not None:
            return own.topic.span
        case ["holds", name, *_]:
            held = (held.resource for statement in declaration.holds for held in statement)
            return next((resource.span for resource in held if resource.text == name), declaration.name.span)
        case ["parameters", name, *_] if (entry := find(declaration.parameters, name)) is not None:
            return entry.name.span
        case ["inputs", name, "tolerates"] if (port := find(declaration.inputs, name)) is not None and port.tolerates:
            return port.tolerates.span
        case ["inputs", name, "condition"] if (port := find(declaration.inputs, name)) is not None and port.condition:
            return port.condition
        case ["inputs", name, *inner] if (port := find(declaration.inputs, name)) is not None:
            return _contract(port.contract, inner, port.name.span)
        case ["outputs", *inner]:
            return _nth(declaration.outputs, inner, declaration.name.span)
        case ["functionalities", name, *inner] if (part := find(declaration.functionalities, name)) is not None:
            return _functionality(part, inner)
    return declaration.name.span


def _functionality(declaration: syntax.FunctionalityDeclaration, rest: Subject) -> Span:
    match rest:
        case ["weight"] if declaration.weight is not None:
            return declaration.weight.span
        case ["uses", *inner]:
            return _nth(declaration.uses, inner, declaration.name.span)
        case ["produces", *inner]:
            return _nth(declaration.produces, inner, declaration.name.span)
        case ["modes", name, *inner] if (mode := find(declaration.modes, name)) is not None:
            return _mode(mode, inner)
    return declaration.name.span


def _mode(mode: syntax.ModeDeclaration, rest: Subject) -> Span:
    match rest:
        case ["assumes", index, *inner] if _within(mode.assumptions, index):
            assumption = mode.assumptions[int(index)]
            if isinstance(assumption, syntax.NamedAssumption):
                return _nth(assumption.inputs, inner[1:], assumption.span)
            return _contract(assumption, inner, assumption.span)
        case ["parameters", name, *_] if (entry := find(mode.parameters, name)) is not None:
            return entry.name.span
        case ["guarantees", name, *inner]:
            stated = next((guarantee for guarantee in mode.guarantees if guarantee.output.text == name), None)
            if stated is not None:
                return _contract(stated.contract, inner, stated.output.span)
    return mode.name.span


def _within(entries: Sequence[object], index: str) -> bool:
    return index.isdecimal() and int(index) < len(entries)


def _nth(names: Sequence[syntax.Name], rest: Subject, otherwise: Span) -> Span:
    """The place of the name whose index ``rest`` begins with."""
    return names[int(rest[0])].span if rest and _within(names, rest[0]) else otherwise


def _contract(contract: syntax.ContractExpression | None, rest: Subject, whole: Span) -> Span:
    """The place of a part of a contract; ``whole`` is what it is the contract of."""
    if contract is None:
        return whole
    match rest:
        case []:
            return whole
        case ["rate", *_] if contract.rate is not None:
            return contract.rate.span
        case ["qos", *inner] if contract.qos:
            name = inner[0] if inner else ""
            return next((p for p in contract.qos if name.startswith(p.name.text)), contract.qos[0]).value.span
        case ["within_seconds", *_] if contract.bound is not None:
            return contract.bound.span
        case ["where", path, *_]:
            return next((c.span for c in contract.where if c.path.text == path), contract.span)
    return contract.span
