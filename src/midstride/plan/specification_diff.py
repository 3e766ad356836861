"""The differences between two specifications: what `midstride diff` shows.

The change of each node is classified as the planners see it: added, removed, replaced, rewired, or with parameters set
in place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal, TypeVar

from immutables import Map

from midstride.codec.form import Form
from midstride.model.component import (
    DEFAULT_CONTAINER,
    ComponentSpec,
    Connector,
    ContainerProgram,
    EnvironmentGuarantee,
    ParameterValue,
    Resource,
    StopTimes,
    same_value,
)
from midstride.model.contract import ConnectorKind, format_number
from midstride.model.hosts import HostSpec, host_in_words, word_of_host
from midstride.model.specification import Node, Specification
from midstride.model.wording import KIND_WORDS

DifferenceKind = Literal["added", "removed", "changed", "renamed", "replaced", "rewired", "set"]

T = TypeVar("T")


class Difference(Form, frozen=True, omit_defaults=False):
    """One difference: of what (``topic /scan``), of which kind, and its details, a line each."""

    subject: str
    kind: DifferenceKind
    details: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join([f"{self.subject}: {self.kind}", *(f"  {detail}" for detail in self.details)])


def differences(old: Specification, new: Specification, renewed: Mapping[str, str] | None = None) -> list[Difference]:
    """Every difference, topics first; empty iff the two are equivalent.

    ``renewed``: the nodes that are replaced in any case, and why.
    """
    was, will = ({offer.name: offer for offer in specification.environment} for specification in (old, new))
    return [
        *_connectors(old.connectors, new.connectors),
        *_compared("host", old.hosts, new.hosts, lambda host: (f"ssh {host.ssh}",), _host),
        *_compared(
            "resource",
            old.resources,
            new.resources,
            lambda resource: (f"capacity {format_number(resource.capacity)}",),
            _resource,
        ),
        *_compared(
            "container",
            old.containers,
            new.containers,
            lambda program: (_program(program),),
            _shared_container,
        ),
        *_compared("environment", was, will, lambda offer: (str(offer.guarantee),), _offer),
        *_components(old.components, new.components),
        *_nodes(old, new, renewed or {}),
        *_rest(old, new),
    ]


def _compared(
    kind: str,
    old: Mapping[str, T],
    new: Mapping[str, T],
    details: Callable[[T], tuple[str, ...]],
    changes: Callable[[T, T], Iterable[str]],
) -> Iterator[Difference]:
    """The declarations that are added (with ``details``), removed and changed."""
    for name in sorted({*old, *new}):
        subject = f"{kind} {name}"
        if name not in old:
            yield Difference(subject, "added", details(new[name]))
        elif name not in new:
            yield Difference(subject, "removed")
        elif found := tuple(changes(old[name], new[name])):
            yield Difference(subject, "changed", found)


def _connectors(old: Mapping[str, Connector], new: Mapping[str, Connector]) -> Iterator[Difference]:
    """Topics, then services, then ROS actions; one that becomes another kind is removed and added."""
    for kind, words in KIND_WORDS.items():
        was, will = ({name: each for name, each in some.items() if each.kind == kind} for some in (old, new))
        yield from _compared(words.connector, was, will, lambda connector: (str(connector.guarantee),), _connector)


def _connector(before: Connector, after: Connector) -> Iterator[str]:
    if not before.same_contract(after):
        yield _became("contract", before.guarantee, after.guarantee)
        connector = KIND_WORDS[after.kind].connector
        yield f"a new contract makes a new {connector}: its ports are detached and attached again"
    if before.max_publishers != after.max_publishers:
        allowed = [
            "any number" if cap is None else f"at most {cap}" for cap in (before.max_publishers, after.max_publishers)
        ]
        yield _became("publishers", *allowed)


def _host(before: HostSpec, after: HostSpec) -> Iterator[str]:
    for word in ("ssh", "setup", "folder"):
        if getattr(before, word) != getattr(after, word):
            yield _became(word, getattr(before, word), getattr(after, word))


def _resource(before: Resource, after: Resource) -> Iterator[str]:
    if before.capacity != after.capacity:
        yield _became("capacity", format_number(before.capacity), format_number(after.capacity))


def _offer(before: EnvironmentGuarantee, after: EnvironmentGuarantee) -> Iterator[str]:
    if before.guarantee != after.guarantee:
        yield _became("guarantee", before.guarantee, after.guarantee)
    if before.topic != after.topic:
        yield _became("topic", before.topic, after.topic)


# -- components ------------------------------------------------------------------------------------------


def _components(old: Mapping[str, ComponentSpec], new: Mapping[str, ComponentSpec]) -> Iterator[Difference]:
    renamed = dict(renamed_components(old, new))
    for before, after in renamed.items():
        yield Difference(f"component {before}", "renamed", (f"to {after}; its nodes keep running",))
    kept = {name: component for name, component in old.items() if name not in renamed}
    others = {name: component for name, component in new.items() if name not in renamed.values()}
    yield from _compared("component", kept, others, lambda _: (), component_differences)


def renamed_components(old: Mapping[str, ComponentSpec], new: Mapping[str, ComponentSpec]) -> Iterator[tuple[str, str]]:
    """The components that differ in nothing but their names, each with its old and its new one."""
    added = [name for name in sorted(new) if name not in old]
    for before in sorted(old):
        if before not in new:
            after = next((name for name in added if _same_but_name(old[before], new[name])), None)
            if after is not None:
                added.remove(after)
                yield before, after


def _same_but_name(before: ComponentSpec, after: ComponentSpec) -> bool:
    return before.same_body(after) and before.parameters == after.parameters


def _stop(stop: StopTimes | None) -> str | None:
    if stop is None:
        return None
    times = (
        ("drain", stop.drain),
        ("patience", stop.patience),
        ("sigterm", stop.sigterm),
        ("sigkill", stop.sigkill),
    )
    return " ".join(f"{name} {format_number(seconds)} s" for name, seconds in times)


def _container(component: ComponentSpec) -> str | None:
    return None if component.container is None else _program(component.container)


def _shared_container(before: ContainerProgram, after: ContainerProgram) -> Iterator[str]:
    for what, old, new in (
        ("run", _program(before), _program(after)),
        ("on", word_of_host(before.host), word_of_host(after.host)),
        ("prefix", before.prefix, after.prefix),
        ("takes", before.startup_seconds, after.startup_seconds),
        ("stop", _stop(before.stop), _stop(after.stop)),
    ):
        if old != new:
            yield _became(what, old, new)
    yield from _named("variable", *(_variables(each.environment) for each in (before, after)))


def _program(container: ContainerProgram) -> str:
    return f"{container.run} of package {container.package}"


def component_differences(before: ComponentSpec, after: ComponentSpec) -> Iterator[str]:
    """The differences between two declarations of a component, a line each."""
    for what, old, new in (
        ("run", before.run, after.run),
        ("takes", before.startup_seconds, after.startup_seconds),
        ("package", before.package, after.package),
        ("in", _container(before), _container(after)),
        ("prefix", before.prefix, after.prefix),
        ("gate", before.gate, after.gate),
        ("unnamed", before.unnamed, after.unnamed),
        ("renames", before.renames, after.renames),
        ("activate", before.activate_seconds, after.activate_seconds),
        ("stop", _stop(before.stop), _stop(after.stop)),
        ("once", before.once or None, after.once or None),
    ):
        if old != new:
            yield _became(what, old, new)
    for kind, words in KIND_WORDS.items():
        yield from _named(words.input, *(_of_kind(kind, each, each.inputs) for each in (before, after)))
    yield from _named("tolerates", before.tolerates, after.tolerates)
    yield from _named("condition", *(dict.fromkeys(sorted(each.conditions), "") for each in (before, after)))
    for kind, words in KIND_WORDS.items():
        outputs = (_of_kind(kind, each, dict.fromkeys(each.outputs, "")) for each in (before, after))
        yield from _named(words.output, *outputs)
    for kind, words in KIND_WORDS.items():
        yield from _named(f"{words.connector} of", *(_of_kind(kind, each, each.topics) for each in (before, after)))
    yield from _named("lazy", *(dict.fromkeys(sorted(each.lazy), "") for each in (before, after)))
    yield from _named("holds", before.resource_usage, after.resource_usage)
    yield from _named("variable", *(_variables(each.environment) for each in (before, after)))
    yield from _named("parameter", _parameters(before), _parameters(after))
    allowed = [{str(endpoint): "" for endpoint in component.allows} for component in (before, after)]
    yield from _named("allows", *allowed)
    for name in dict.fromkeys([*before.functionality_order, *after.functionality_order]):
        yield from _functionality(name, before, after)


def _variables(environment: Mapping[str, str | None]) -> dict[str, str]:
    return {name: "unset" if value is None else repr(value) for name, value in environment.items()}


def _parameters(component: ComponentSpec) -> dict[str, str]:
    return {
        name: f"{'changeable ' if parameter.changeable else ''}{parameter.value!r}"
        for name, parameter in component.parameters.items()
    }


def _functionality(name: str, before: ComponentSpec, after: ComponentSpec) -> Iterator[str]:
    old, new = before.functionalities.get(name), after.functionalities.get(name)
    if old is None or new is None:
        yield f"functionality {name}: {'added' if old is None else 'removed'}"
        return
    where = f"functionality {name}"
    if old.weight != new.weight:
        yield _became(f"{where}: weight", format_number(old.weight), format_number(new.weight))
    for what, then, now in (("uses", old.inputs, new.inputs), ("produces", old.outputs, new.outputs)):
        if set(then) != set(now):
            yield _became(f"{where}: {what}", ", ".join(then), ", ".join(now))
    modes = [[mode.name for mode in functionality.modes] for functionality in (old, new)]
    if modes[0] != modes[1]:
        yield _became(f"{where}: modes", ", ".join(modes[0]), ", ".join(modes[1]))
    for mode in old.modes:
        other = next((candidate for candidate in new.modes if candidate.name == mode.name), None)
        if other is None:
            continue
        if mode.needs() != other.needs():
            assumed = [", ".join(str(a) for a in m.assumptions) or "nothing" for m in (mode, other)]
            yield _became(f"{where}, mode {mode.name}: assumes", *assumed)
        if mode.parameters != other.parameters:
            stated = [", ".join(f"{name} = {v!r}" for name, v in sorted(m.parameters.items())) for m in (mode, other)]
            yield _became(f"{where}, mode {mode.name}: parameters", *(each or "none" for each in stated))
        for output in sorted({*mode.guarantees, *other.guarantees}):
            given, gives = mode.guarantee(output), other.guarantee(output)
            if given != gives:
                yield _became(f"{where}, mode {mode.name}: {output}", given, gives)


# -- nodes -----------------------------------------------------------------------------------------------


def _nodes(old: Specification, new: Specification, renewed: Mapping[str, str]) -> Iterator[Difference]:
    for role in sorted({*old.nodes, *new.nodes}):
        before, after = old.nodes.get(role), new.nodes.get(role)
        subject = f"node {role}"
        if before is None and after is not None:
            yield Difference(subject, "added", (f"component {after.component}",))
        elif after is None:
            yield Difference(subject, "removed")
        elif before is not None:
            yield from _node(subject, old, new, before, after, renewed.get(role))


def _node(
    subject: str, old: Specification, new: Specification, before: Node, after: Node, why: str | None
) -> Iterator[Difference]:
    details: list[str] = [] if why is None else [why]
    was, will = old.component_of(before.role), new.component_of(after.role)
    replaced = not was.same_body(will)
    if replaced and before.component != after.component:
        details.append(_became("component", before.component, after.component))
    elif replaced:
        details.append(f"component {after.component} is declared differently")
    then, now = old.instance(before.role).parameters, new.instance(after.role).parameters
    for name in sorted({*then, *now}):
        if name in then and name in now and same_value(then[name], now[name]):
            continue
        declared = [component.parameters.get(name) for component in (was, will)]
        in_place = not replaced and all(parameter is not None and parameter.changeable for parameter in declared)
        became = _became(f"parameter {name}", then.get(name), now.get(name))
        details.append(became + (", set in place" if in_place else ""))
        replaced = not in_place
    if sections := list(_sections(before, after)):
        details += sections
        replaced = True
    if before.host != after.host:
        details.append(f"moves from {host_in_words(before.host)} to {host_in_words(after.host)}")
        replaced = True
    if before.container != after.container:
        details.append(_became("container", before.container, after.container))
        replaced = True
    elif before.container is not None:
        programs = [each.containers.get(before.container, DEFAULT_CONTAINER) for each in (old, new)]
        if not programs[0].same_process(replace(programs[1], host=programs[0].host)):
            details.append(f"container {before.container} has another program or environment")
            replaced = True
    wiring = list(_wiring(before, after))
    replaced = replaced or (bool(wiring) and was.gate is not None)  # its topics are fixed at its start
    policy = [] if before.respawn == after.respawn else [_became("respawn", before.respawn, after.respawn)]
    if details or wiring or policy:
        kind: DifferenceKind = "replaced" if replaced or why is not None else "rewired" if wiring else "set"
        yield Difference(subject, kind if details or wiring else "changed", (*details, *wiring, *policy))


def _sections(before: Node, after: Node) -> Iterator[str]:
    """The values for further nodes in the process that are others, and whether their order is."""
    then, now = ({each.pattern: each.parameters for each in node.sections} for node in (before, after))
    for pattern in dict.fromkeys([*then, *now]):
        old, new = (each.get(pattern, Map[str, ParameterValue]()) for each in (then, now))
        for name in sorted({*old, *new}):
            if not (name in old and name in new and same_value(old[name], new[name])):
                yield _became(f"parameter {name} of the section {pattern}", old.get(name), new.get(name))
    if list(then) != list(now):
        yield _became("sections for its process", *(", ".join(each) or "none" for each in (then, now)))


def _wiring(before: Node, after: Node) -> Iterator[str]:
    for port in sorted({*before.attachments, *after.attachments}):
        then, now = before.attachments.get(port, ()), after.attachments.get(port, ())
        for topic in sorted({*then, *now}):
            if topic not in now:
                yield f"{port} is detached from {topic}"
            elif topic not in then:
                yield f"{port} is attached to {topic}"


def _rest(old: Specification, new: Specification) -> Iterator[Difference]:
    for constraint in old.constraints:
        if constraint not in new.constraints:
            yield Difference(f"constraint `{constraint}`", "removed")
    for constraint in new.constraints:
        if constraint not in old.constraints:
            yield Difference(f"constraint `{constraint}`", "added")
    for requirement in old.requirements:
        if requirement not in new.requirements:
            yield Difference(f"`{requirement}`", "removed")
    for requirement in new.requirements:
        if requirement not in old.requirements:
            yield Difference(f"`{requirement}`", "added")
    if details := tuple(_named("step", old.timing, new.timing)):
        yield Difference("timing", "changed", details)


def _of_kind(kind: ConnectorKind, component: ComponentSpec, values: Mapping[str, T]) -> dict[str, T]:
    """``values`` of those ports of ``component`` that belong to a connector of that kind."""
    return {port: value for port, value in values.items() if component.kind_of(port) == kind}


def _named(what: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    for name in sorted({*before, *after}):
        if name not in before:
            yield f"{what} {name}: added" + (f", {after[name]}" if after[name] != "" else "")
        elif name not in after:
            yield f"{what} {name}: removed"
        elif before[name] != after[name]:
            yield _became(f"{what} {name}", before[name], after[name])


def _became(what: str, before: object, after: object) -> str:
    values = ["not stated" if value is None else str(value) for value in (before, after)]
    return f"{what}: {values[0]} -> {values[1]}"
