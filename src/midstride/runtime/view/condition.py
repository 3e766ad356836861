"""The condition of a running system: which nodes run, and what of them is missing or worse than it should be."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from midstride.runtime.records.status_forms import CrashedInstance, InstanceStatus, SilenceFault
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.verdicts import assessment, conditions, unmeasured
from midstride.verdicts.conditions import SystemCondition


def condition(
    watched: WatchedSystem,
    instances: Iterable[InstanceStatus],
    crashed: Sequence[CrashedInstance],
    silences: Sequence[SilenceFault],
    violations: Sequence[str],
) -> SystemCondition:
    """Return what may be said of the system, whose ``instances`` are as in its status.

    While a role has two instances, as during a change, the one with fewer faults counts.
    """
    specification = watched.system.specification
    best: dict[str, tuple[InstanceStatus, list[str]]] = {}
    for instance in instances:
        found = list(_faults(watched, instance))
        known = best.get(instance.role)
        if known is None or (not instance.reachable, len(found)) < (not known[0].reachable, len(known[1])):
            best[instance.role] = instance, found
    gone = {each.role: each for each in crashed if each.role is not None}
    faults = [conditions.is_missing(each.role or each.name, each.words) for each in crashed if each.role not in best]
    faults += [conditions.does_not_run(role) for role in specification.roles() if role not in best and role not in gone]
    faults += _lost_hosts(watched, silences)
    faults += [
        assessment.silence_in_words(fault.words, fault.seconds or None)
        for fault in silences
        if fault.kind != "unreachable"
    ]
    faults += [words for role in sorted(best) for words in best[role][1]]
    faults += [words for role in sorted(best) if (words := watched.respawner.crash_loop(role)) is not None]
    faults += watched.backend.hanging()
    components = {role: specification.component_of(role) for role in specification.roles()}
    present = [best[role][0] for role in components if role in best]
    running = [each for each in present if not each.unreachable]
    return conditions.system_condition(
        len(components),
        len(running),
        [*faults, *violations],
        [
            *unmeasured.unmeasured_in_words({role: each for role, each in components.items() if role in best}),
            *(words for role in sorted(best) for words in unmeasured_bounds(watched.system, best[role][0].name)),
        ],
        answering=sum(each.reachable or each.done for each in running),
        unreachable=len(present) - len(running),
        slow=[words for role in sorted(best) for words in _below_rate(best[role][0], far=False)],
    )


def unmeasured_bounds(system: RunningSystem, instance: str) -> Iterator[str]:
    """Yield of which servers of an instance nothing shows whether they keep their bounds, and why."""
    configuration, state = system.configuration, system.life.responsive(instance)
    if state is None or instance not in configuration.instances:
        return
    gate = configuration.component(instance).gate
    for port, connector in configuration.attached_ports(instance):
        name = configuration.topic(connector)
        link = state.ports.get(port.port, {}).get(name)
        serves = configuration.is_output(port) and not configuration.is_topic(connector)
        if not serves or link is None or link.responses is not None or configuration.bound(port) is None:
            continue
        if gate == "none":
            yield unmeasured.bound_not_known(str(port), name, "nothing counts requests (`gate none`)")
        elif state.simulated_time:
            yield unmeasured.bound_not_known(str(port), name, "nothing that measures rates follows `/clock`")


def _lost_hosts(watched: WatchedSystem, silences: Sequence[SilenceFault]) -> Iterator[str]:
    """Yield one fault for each host with unreachable nodes: of many nodes, the reason is the same."""
    instances = watched.system.configuration.instances
    by_host: dict[str, list[str]] = {}
    for each in silences:
        if each.kind == "unreachable" and each.instance in instances:
            by_host.setdefault(instances[each.instance].host, []).append(each.instance)
    for host, names in sorted(by_host.items()):
        yield conditions.cannot_be_reached(host, names)


def _faults(watched: WatchedSystem, instance: InstanceStatus) -> Iterator[str]:
    """Yield what an instance does worse than it should, where it answers: else that is a silence."""
    if not instance.reachable:
        return
    baseline = watched.baseline()
    if instance.waiting is not None:
        yield conditions.waits(instance.name, instance.waiting)
    yield from instance.differences
    for each in instance.functionalities:
        if each.mode not in each.modes or each.modes.index(each.mode) > baseline.level(instance.role, each.name):
            yield conditions.is_in_mode(f"{instance.name}.{each.name}", each.mode)
    configuration = watched.system.configuration
    if instance.name in configuration.instances and not instance.done:
        attached = {(port.port, connector) for port, connector in configuration.attached_ports(instance.name)}
        for port, connector in baseline.attached(instance.role):
            if (port, connector) not in attached:
                yield conditions.is_not_attached(f"{instance.name}.{port}", connector)
    yield from _below_rate(instance, far=True)


def _below_rate(instance: InstanceStatus, *, far: bool) -> Iterator[str]:
    """The outputs that do not keep the rates that they guarantee: those ``far`` below, or the others."""
    for port in instance.ports if instance.reachable else ():
        below = port.direction == "out" and port.gate != "closed" and port.met is False
        if below and conditions.is_far_below(port.rate, port.declared) is far:
            yield conditions.writes_less(f"{instance.name}.{port.name}", port.rate, port.declared)
