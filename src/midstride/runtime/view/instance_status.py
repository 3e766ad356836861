"""The status of one instance, from its last report and the manager's model.

For the stream of the live view it is built up to 20 times a second for each instance that changes, so what does not
change with a report is prepared. There, measurements are rounded, and what changes with every look is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from msgspec import UNSET, structs

from midstride.model.component import FunctionalityRef, FunctionalitySpec, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.graph_names import resolved
from midstride.runtime.backend_protocol import OtherNodes
from midstride.runtime.process.registration import REPORTED
from midstride.runtime.records.mode_recorder import SAME_MODE
from midstride.runtime.records.status_forms import (
    EndpointStatus,
    FieldStatus,
    FunctionalityStatus,
    InstanceStatus,
    OtherNodeStatus,
    ParameterStatus,
    PortStatus,
)
from midstride.runtime.view.rounded_measurements import Measurements, differ_noticeably, rounded
from midstride.runtime.view.watched_system import Baseline, WatchedSystem
from midstride.wire.state import THIS_HOST, ComponentState, Endpoint, FunctionalityState, LinkState

_NO_OTHERS: Final = OtherNodes()
_NO_LINKS: Final[dict[str, LinkState]] = {}


@dataclass(frozen=True, slots=True)
class _PortShape:
    """A port on a topic, or on none: ``topic`` is that of ``connector``."""

    name: str
    direction: Literal["in", "out"]
    functionalities: list[str]
    connector: str | None
    topic: str | None
    type: str | None


@dataclass(slots=True)
class EntryShape:
    """The part of an entry that depends on the instance and its attachments alone; made anew when these change."""

    instance: Instance
    functionalities: list[tuple[FunctionalityRef, FunctionalitySpec, list[str]]]
    ports: list[_PortShape]
    _declared: dict[tuple[str, ...], list[float | None]] = field(default_factory=dict)

    @classmethod
    def of(cls, configuration: Configuration, instance: Instance) -> EntryShape:
        functionalities = [
            (FunctionalityRef(instance.name, each.name), each, [mode.name for mode in each.modes])
            for each in instance.component
        ]
        return cls(instance, functionalities, list(_port_shapes(configuration, instance)))

    def declared(self, state: ComponentState) -> list[float | None]:
        """The rate (Hz) that each of ``ports`` declares in the modes that the component reports."""
        modes = {name: each.mode for name, each in state.functionalities.items()}
        key = tuple(modes.values())
        if key not in self._declared:
            self._declared[key] = [self.instance.component.stated_rate(port.name, modes) for port in self.ports]
        return self._declared[key]


def _port_shapes(configuration: Configuration, instance: Instance) -> Iterator[_PortShape]:
    component = instance.component
    for port in component.ports():
        owner = component.find_owner(port)
        users = [each.name for each in (component.users(port) if owner is None else [owner])]
        connectors: list[str | None] = [*configuration.attached_to(PortRef(instance.name, port))]
        for connector in connectors or [None]:
            topic = None if connector is None else configuration.topic(connector)
            direction: Literal["in", "out"] = "in" if owner is None else "out"
            yield _PortShape(port, direction, users, connector, topic, component.type_of(port))


def instance_status(
    watched: WatchedSystem,
    shape: EntryShape,
    now: float,
    shown: InstanceStatus | None,
    ports: list[PortStatus],
    *,
    exact: bool = False,
) -> InstanceStatus:
    """The status of the instance of ``shape`` at ``now`` (UNIX time), where ``shown`` is the one before.

    ``exact``: with what changes with every look.
    """
    instance, configuration, baseline = shape.instance, watched.system.configuration, watched.baseline()
    latest = watched.system.life.latest(instance.name)
    state = watched.system.life.responsive(instance.name)
    handle = watched.system.life[instance.name].handle
    others = watched.system.other_nodes.get(instance.name, _NO_OTHERS)
    process = state or handle
    lost = state is None and watched.monitor.is_unreachable(instance.name, configuration)
    reported = now if latest is None else now - (watched.clock.steady() - latest.at)
    modes = list(_functionalities(watched, configuration, shape, state, reported, shown, exact))
    return InstanceStatus(
        name=instance.name,
        role=instance.role,
        component=instance.component.name,
        container=None if instance.container is None else instance.container.name,
        process=instance.process or None,
        namespace=namespace_of(instance.role),
        host=instance.host or (None if state is None or state.host in {"", THIS_HOST} else state.host),
        node=None if state is None else state.node,
        pid=None if process is None else process.pid,
        reachable=state is not None,
        unreachable=lost,
        answers=state is not None and state.answers,
        ending=watched.system.life.is_ending(instance.name),
        done=watched.system.life.is_done(instance.name),
        waiting=None if state is None else state.waiting,
        as_modelled=all(each.mode == each.modelled for each in modes),
        differences=[] if state is None else [*state.differences, *_misnamed(instance, others)],
        undeclared=[] if state is None else [each.words for each in state.undeclared],
        other_nodes=[
            OtherNodeStatus(each.name, [*each.publishes], [*each.serves], each.namesake) for each in others.nodes
        ],
        other_nodes_unknown=others.unknown,
        deviation="; ".join(_deviations(instance, state, modes, ports, baseline, lost=lost)) or None,
        simulated_time=state is not None and state.simulated_time,
        run=instance.component.run,
        log_file=None if handle is None else handle.log_file,
        functionalities=modes,
        ports=ports,
        parameters=[] if state is None else parameters(state),
        endpoints=endpoints(instance, state, watched.client.endpoints(instance.name)),
    )


def _misnamed(instance: Instance, others: OtherNodes) -> Iterator[str]:
    """Yield that `renames` names no node of the process, so that none has the name of the instance's node."""
    renames = instance.component.renames
    if renames is not None and others.without_own:
        yield (
            f"`renames {renames}` is the name of no node of its process, which has {others.in_words}: "
            "state what the program calls the one that is meant"
        )


def is_sound(status: InstanceStatus) -> bool:
    """Return whether an instance does what its modes guarantee. One that waits for a simulation's clock does not."""
    return status.as_modelled and status.waiting is None and not status.differences


def parameters(state: ComponentState) -> list[ParameterStatus]:
    """The parameters of a component, by name."""
    return [
        ParameterStatus(
            name,
            value,
            state.declared.get(name, value),
            name in state.declared,
            "node" if name in state.own_values else "unknown" if name in state.unknown_origin else UNSET,
            state.set_at.get(name, UNSET),
        )
        for name, value in sorted(state.parameters.items())
    ]


def endpoints(instance: Instance, state: ComponentState | None, reported: Sequence[Endpoint]) -> list[EndpointStatus]:
    """The endpoints that the component of ``instance`` allows; which end its node has is known where it has
    ``reported`` that.

    A node with others is refused when it starts, so these are all.
    """
    if not instance.component.allows:
        return []
    node = instance.role if state is None or state.node is None else state.node
    ends = {(endpoint.kind, endpoint.name): endpoint.serves for endpoint in reported}
    found = {(REPORTED[each.kind], resolved(each.name, node)) for each in instance.component.allows}
    return [EndpointStatus(kind=kind, name=name, serves=ends.get((kind, name))) for kind, name in sorted(found)]


def namespace_of(role: str) -> str:
    """The namespace of ``role``, such as ``/`` or ``/front``."""
    return f"/{role.rpartition('/')[0]}"


def _functionalities(
    watched: WatchedSystem,
    configuration: Configuration,
    shape: EntryShape,
    state: ComponentState | None,
    reported: float,
    shown: InstanceStatus | None,
    exact: bool,
) -> Iterator[FunctionalityStatus]:
    before = {} if shown is None else {each.name: each for each in shown.functionalities}
    for ref, functionality, modes in shape.functionalities:
        modelled = modes[configuration.modes[ref]]
        found = None if state is None else state.functionalities.get(functionality.name)
        mode = modelled if found is None else found.mode
        yield FunctionalityStatus(
            name=functionality.name,
            mode=mode,
            modes=modes,
            modelled=modelled,
            normal=mode == modes[0],
            because=None if found is None else found.because,
            reflex=found is not None and found.reflex,
            restoring=watched.restorer.status(ref),
            since=None if found is None else _since(found, reported, before.get(functionality.name)),
            busy=(None if found is None else found.busy) if exact else UNSET,
        )


def _since(found: FunctionalityState, reported: float, before: FunctionalityStatus | None) -> float:
    """The begin of the mode: the same as before while it lasts, although the delays of reports differ."""
    began = reported - found.since
    known = before.since if before is not None and before.mode == found.mode else None
    return known if known is not None and abs(began - known) <= SAME_MODE else round(began, 3)


def port_statuses(
    shape: EntryShape,
    state: ComponentState | None,
    before: Sequence[PortStatus] = (),
    *,
    refresh: bool = True,
    exact: bool = False,
) -> list[PortStatus]:
    """The ports of the instance; ``before`` are those of the entry before, if that had the same shape, else empty.

    ``refresh``: with new measurements. A port that stays the same is the same object. ``exact``: as measured.
    """
    if state is None:
        return [_port(port, None, None, None, refresh, exact) for port in shape.ports]
    found: list[PortStatus] = []
    for index, (port, declared) in enumerate(zip(shape.ports, shape.declared(state), strict=True)):
        link = None if port.topic is None else state.ports.get(port.name, _NO_LINKS).get(port.topic)
        found.append(_port(port, link, declared, before[index] if before else None, refresh, exact))
    return found


def _port(
    port: _PortShape,
    link: LinkState | None,
    declared: float | None,
    shown: PortStatus | None,
    refresh: bool,
    exact: bool,
) -> PortStatus:
    gate, measured, samples = (None, None, {}) if link is None else (link.gate, link.measured, link.fields)
    kept_out = link is not None and link.kept_out
    met = None if declared is None or measured is None else measured.meets(declared)
    refresh = refresh or link is None
    if exact:
        found = Measurements() if measured is None else Measurements.of(measured)
    elif shown is None:
        found = rounded(measured)
    elif (
        shown.gate == gate
        and shown.kept_out == kept_out
        and shown.declared == declared
        and shown.met == met
        and not (refresh and differ_noticeably(shown, measured))
    ):
        return shown
    else:
        before = Measurements(shown.rate, shown.age, shown.jitter, shown.longest)
        found = rounded(measured, before) if refresh else before
    return PortStatus(
        name=port.name,
        direction=port.direction,
        functionalities=port.functionalities,
        topic=port.connector,
        type=port.type,
        gate=gate,
        declared=declared,
        rate=found.rate,
        met=met,
        age=found.age,
        jitter=found.jitter,
        longest=found.longest,
        window=(None if measured is None else measured.window) if exact else UNSET,
        fields=[FieldStatus(field=name, **structs.asdict(each)) for name, each in samples.items()] if exact else UNSET,
        kept_out=kept_out,
    )


def _deviations(
    instance: Instance,
    state: ComponentState | None,
    functionalities: list[FunctionalityStatus],
    ports: list[PortStatus],
    baseline: Baseline,
    *,
    lost: bool = False,
) -> Iterator[str]:
    """In which way an instance is not as specified."""
    specification, role = baseline.specification, instance.role
    if state is None and not instance.component.once:
        yield f"its host {instance.host} cannot be reached" if lost else "it does not answer"
    elif state is not None and state.waiting is not None:
        yield f"it is waiting: {state.waiting}"
    if role not in specification.nodes:
        yield "the specification does not have it"
    elif (meant := specification.nodes[role].component) != instance.component.name:
        yield f"the specification has {meant} there"
    if state is not None:
        yield from state.differences
    for each in functionalities:
        if each.mode not in each.modes or each.modes.index(each.mode) > baseline.level(role, each.name):
            yield f"{each.name} is in mode {each.mode}"
    for port in ports:
        if port.met is False and port.gate != "closed":
            yield f"{port.name} {'publishes' if port.direction == 'out' else 'receives'} less than declared"
