"""The entry of one component in the live view, from its last report and the manager's model.

It is built up to 20 times a second for each component that changes, so what does not change with a report is prepared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from midstride.model.component import FunctionalityRef, FunctionalitySpec, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.runtime.view import status
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.server.view.endpoint_views import endpoint_views
from midstride.server.view.rounded_measurements import Figures, differ, figures
from midstride.server.view.view_forms import ComponentView, FunctionalityView, PortView
from midstride.wire.state import THIS_HOST, ComponentState, FunctionalityState, LinkState

# By how much (s) the beginning of a mode may seem to move between two reports, which travel for different times.
_SAME_MODE: Final = 0.5
_NO_LINKS: Final[dict[str, LinkState]] = {}


class Baseline:
    """What the specification provides: for each role its component, and the best modes that the system allows."""

    def __init__(self, specification: Specification, intended: Configuration) -> None:
        self.specification = specification
        self._modes = intended.modes

    def level(self, role: str, functionality: str) -> int:
        """The level of the mode that a functionality of a role should be in; 0 (the best) for an unknown one."""
        return self._modes.get(FunctionalityRef(role, functionality), 0)


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
    """What of an entry depends on the instance and its attachments alone; another one is made when these change."""

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


def component_view(
    watched: WatchedSystem,
    configuration: Configuration,
    shape: EntryShape,
    baseline: Baseline,
    now: float,
    shown: ComponentView | None,
    ports: list[PortView],
) -> ComponentView:
    """The entry of the instance of ``shape`` at ``now`` (UNIX time), where ``shown`` is the one before."""
    instance = shape.instance
    latest = watched.system.life.latest(instance.name)
    state = watched.system.life.responsive(instance.name)
    handle = watched.system.life[instance.name].handle
    process = state or handle
    reported = now if latest is None else now - (watched.clock.steady() - latest.at)
    modes = list(_functionalities(watched, configuration, shape, state, reported, shown))
    return ComponentView(
        name=instance.name,
        role=instance.role,
        component=instance.component.name,
        namespace=namespace_of(instance.role),
        host=None if state is None or state.host in {"", THIS_HOST} else state.host,
        node=None if state is None else state.node,
        pid=None if process is None else process.pid,
        answers=state is not None,
        ending=watched.system.life.is_ending(instance.name),
        waiting=None if state is None else state.waiting,
        as_modelled=all(each.mode == each.modelled for each in modes),
        differences=[] if state is None else state.differences,
        undeclared=[] if state is None else state.undeclared,
        deviation="; ".join(_deviations(instance, state, modes, ports, baseline)) or None,
        functionalities=modes,
        ports=ports,
        parameters=[] if state is None else status.parameters(state),
        endpoints=endpoint_views(instance, state, watched.client.endpoints(instance.name)),
    )


def namespace_of(role: str) -> str:
    """As ``/`` or ``/front``."""
    return f"/{role.rpartition('/')[0]}"


def _functionalities(
    watched: WatchedSystem,
    configuration: Configuration,
    shape: EntryShape,
    state: ComponentState | None,
    reported: float,
    shown: ComponentView | None,
) -> Iterator[FunctionalityView]:
    before = {} if shown is None else {each.name: each for each in shown.functionalities}
    for ref, functionality, modes in shape.functionalities:
        modelled = modes[configuration.modes[ref]]
        found = None if state is None else state.functionalities.get(functionality.name)
        mode = modelled if found is None else found.mode
        yield FunctionalityView(
            name=functionality.name,
            mode=mode,
            modes=modes,
            modelled=modelled,
            normal=mode == modes[0],
            because=None if found is None else found.because,
            reflex=found is not None and found.reflex,
            restoring=watched.restorer.status(ref),
            since=None if found is None else _since(found, reported, before.get(functionality.name)),
        )


def _since(found: FunctionalityState, reported: float, before: FunctionalityView | None) -> float:
    """When the mode began: the same as before while it lasts, although each report was on its way for another time."""
    began = reported - found.since
    known = before.since if before is not None and before.mode == found.mode else None
    return known if known is not None and abs(began - known) <= _SAME_MODE else round(began, 3)


def port_views(
    shape: EntryShape, state: ComponentState | None, before: Sequence[PortView], *, refresh: bool
) -> list[PortView]:
    """The ports of the instance; ``before`` are those of the entry before, if that had the same shape, else empty.

    ``refresh``: with new figures. A port that stays the same is the same object.
    """
    if state is None:
        return [_port(port, None, None, None, refresh) for port in shape.ports]
    found: list[PortView] = []
    for index, (port, declared) in enumerate(zip(shape.ports, shape.declared(state), strict=True)):
        link = None if port.topic is None else state.ports.get(port.name, _NO_LINKS).get(port.topic)
        found.append(_port(port, link, declared, before[index] if before else None, refresh))
    return found


def _port(
    port: _PortShape, link: LinkState | None, declared: float | None, shown: PortView | None, refresh: bool
) -> PortView:
    gate, measured = (None, None) if link is None else (link.gate, link.measured)
    met = None if declared is None or measured is None else measured.meets(declared)
    refresh = refresh or link is None
    if shown is None:
        found = figures(measured)
    elif (
        shown.gate == gate
        and shown.declared == declared
        and shown.met == met
        and not (refresh and differ(shown, measured))
    ):
        return shown
    else:
        before = Figures(shown.rate, shown.age, shown.jitter, shown.longest)
        found = figures(measured, before) if refresh else before
    return PortView(
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
    )


def _deviations(
    instance: Instance,
    state: ComponentState | None,
    functionalities: list[FunctionalityView],
    ports: list[PortView],
    baseline: Baseline,
) -> Iterator[str]:
    """In which way an instance is not as specified."""
    specification, role = baseline.specification, instance.role
    if state is None:
        yield "it does not answer"
    elif state.waiting is not None:
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
