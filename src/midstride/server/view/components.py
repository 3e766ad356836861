"""The entry of one component in the live view, from its last report and the manager's model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from midstride.model.component import ComponentSpec, FunctionalityRef, FunctionalitySpec, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.runtime import status
from midstride.runtime.watched import WatchedSystem
from midstride.server.view.figures import NO_FIGURES, Figures, figures
from midstride.server.view.forms import ComponentView, FunctionalityView, PortView
from midstride.wire.state import ComponentState, FunctionalityState, LinkState

# By how much (s) the beginning of a mode may seem to move between two reports, which travel for different times.
_SAME_MODE: Final = 0.5


class Baseline:
    """What the specification provides: for each role its component, and the best modes that the system allows."""

    def __init__(self, specification: Specification, intended: Configuration) -> None:
        self.specification = specification
        self._modes = intended.modes

    def level(self, role: str, functionality: str) -> int:
        """The level of the mode that a functionality of a role should be in; 0 (the best) for an unknown one."""
        return self._modes.get(FunctionalityRef(role, functionality), 0)


def component_view(
    watched: WatchedSystem,
    configuration: Configuration,
    instance: Instance,
    baseline: Baseline,
    now: float,
    shown: ComponentView | None,
) -> ComponentView:
    """The entry of ``instance`` at ``now`` (UNIX time), where ``shown`` is the one before."""
    latest = watched.client.latest(instance.name)
    state = watched.client.responsive(instance.name)
    handle = watched.launcher.handles.get(instance.name)
    process = state or handle
    reported = now if latest is None else now - (watched.clock.steady() - latest.at)
    before = {} if shown is None else {each.name: each for each in shown.functionalities}
    modes = [
        _functionality(watched, configuration, instance.name, each, state, reported, before.get(each.name))
        for each in instance.component
    ]
    ports = list(_ports(configuration, instance, state, shown))
    as_modelled = all(each.mode == each.modelled for each in modes)
    return ComponentView(
        name=instance.name,
        role=instance.role,
        component=instance.component.name,
        namespace=f"/{instance.role.rpartition('/')[0]}",
        host=None,
        node=None if state is None else state.node,
        pid=None if process is None else process.pid,
        answers=state is not None,
        ending=instance.name in watched.launcher.ending,
        waiting=None if state is None else state.waiting,
        as_modelled=as_modelled,
        differences=[] if state is None else state.differences,
        undeclared=[] if state is None else state.undeclared,
        deviation="; ".join(_deviations(instance, state, modes, ports, baseline)) or None,
        functionalities=modes,
        ports=ports,
        parameters=[] if state is None else status.parameters(state),
    )


def _functionality(
    watched: WatchedSystem,
    configuration: Configuration,
    instance: str,
    functionality: FunctionalitySpec,
    state: ComponentState | None,
    reported: float,
    before: FunctionalityView | None,
) -> FunctionalityView:
    ref = FunctionalityRef(instance, functionality.name)
    modelled = functionality.modes[configuration.modes[ref]].name
    found = None if state is None else state.functionalities.get(functionality.name)
    mode = modelled if found is None else found.mode
    return FunctionalityView(
        name=functionality.name,
        mode=mode,
        modes=[each.name for each in functionality.modes],
        modelled=modelled,
        normal=mode == functionality.modes[0].name,
        because=None if found is None else found.because,
        reflex=found is not None and found.reflex,
        restoring=watched.restorer.status(ref),
        since=None if found is None else _since(found, reported, before),
    )


def _since(found: FunctionalityState, reported: float, before: FunctionalityView | None) -> float:
    """When the mode began: the same as before while it lasts, although each report was on its way for another time."""
    began = reported - found.since
    known = before.since if before is not None and before.mode == found.mode else None
    return known if known is not None and abs(began - known) <= _SAME_MODE else round(began, 3)


def _ports(
    configuration: Configuration, instance: Instance, state: ComponentState | None, shown: ComponentView | None
) -> Iterator[PortView]:
    component = instance.component
    modes = {} if state is None else {name: each.mode for name, each in state.functionalities.items()}
    before = {} if shown is None else {(each.name, each.topic): each for each in shown.ports}
    for port in component.ports():
        connectors: list[str | None] = [*configuration.attached_to(PortRef(instance.name, port))]
        declared = component.stated_rate(port, modes)
        for connector in connectors or [None]:
            link = None
            if connector is not None and state is not None:
                link = state.ports.get(port, {}).get(configuration.topic(connector))
            yield _port(component, port, connector, link, declared, before.get((port, connector)))


def _port(
    component: ComponentSpec,
    port: str,
    topic: str | None,
    link: LinkState | None,
    declared: float | None,
    shown: PortView | None,
) -> PortView:
    measured = None if link is None else link.measured
    before = NO_FIGURES if shown is None else Figures(shown.rate, shown.age, shown.jitter, shown.longest)
    found = NO_FIGURES if link is None else figures(link, before)
    owner = component.find_owner(port)
    users = component.users(port) if owner is None else [owner]
    return PortView(
        name=port,
        direction="in" if owner is None else "out",
        functionalities=[each.name for each in users],
        topic=topic,
        type=component.type_of(port),
        gate=None if link is None else link.gate,
        declared=declared,
        rate=found.rate,
        met=None if declared is None or measured is None else measured.meets(declared),
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
