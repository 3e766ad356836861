"""Recovers a running system that an earlier manager left.

The state store has the earlier manager's model; the components report the actual state, which takes precedence. A
second instance of a role, left by a manager that was killed during a change, is terminated. What is left of that change
is a difference to the specification, which the manager removes by an ordinary plan (docs/protocols/recovery.md).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from types import MappingProxyType

from midstride.errors import CommandRefused, MidstrideError, ProtocolError, Unreachable
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.specification import Specification
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.instance_life import ProcessEvent
from midstride.runtime.process.answering_instance import have_answer
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import Launcher
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.state_store import SavedInstance
from midstride.runtime.restore.half_done import HALF_DONE, HalfDone
from midstride.runtime.watch.observed_configuration import reported_modes
from midstride.wire.commands import FenceCommand, GateCommand, RecordCommand, ResolveCutsCommand
from midstride.wire.frames import PROTOCOL
from midstride.wire.state import NOT_WELCOMED, ComponentState


async def recover(
    saved: Sequence[SavedInstance],
    specification: Specification,
    half_done: HalfDone,
    targets: Sequence[Specification] = (),
    waiting: Mapping[str, str] = MappingProxyType({}),
    silent: Container[str] = (),
) -> Configuration:
    """The configuration of the components that still run, after terminating those that were only partly started.

    ``half_done`` ends these. ``targets``: where interrupted changes led; components may be attached to the topics of
    these already. ``waiting``: by role, the UUID of the process whose exported state its instance is to import, and
    answers then. A component started by hand that does not answer is left out, as are ``silent`` ones, which counted
    as exited on a host that cannot be reached: they are ended once it is. Raises Unreachable for others.
    """
    launcher, client, events = half_done.launcher, half_done.client, half_done.events
    found: dict[str, tuple[Instance, ComponentState]] = {}
    done: dict[str, Instance] = {}
    just_started: list[tuple[Instance, ComponentState]] = []
    hanging: list[str] = []
    for entry in saved:
        instance, handle = entry.instance, entry.handle
        if instance.component.once:
            if not entry.done:
                if handle is not None and await launcher.end_if_running(handle):
                    words = f"stopped {instance.name}, whose program had not ended: what it had done is not known"
                    events.add(HALF_DONE, words)
            elif (same := done.get(instance.role)) is None or _is_asked_for(instance, same, specification):
                done[instance.role] = instance
            continue
        try:
            state = await launcher.adopt(handle or Handle(instance.name), instance.started, owned=handle is not None)
        except (ProtocolError, Unreachable) as error:
            if handle is not None:
                if isinstance(error, ProtocolError):
                    raise
                if instance.name in silent and handle.host:
                    because = f"{instance.name} still counts as exited: {error}"
                    client.life.left_silent(handle, instance.role, because)
                    events.add("note", because)
                else:
                    hanging.append(str(error))
                continue
            events.add("note", f"{error}; it is left out until it does")
            launcher.leave(instance.name)
            continue
        if state is None:
            events.add("gone", f"{instance.name} is no longer running")
            await launcher.abandon(instance.name)
            continue
        if state.waiting == NOT_WELCOMED and handle is not None:  # what it is has not been checked
            just_started.append((instance, state))
            continue
        found[instance.name] = (instance, state)
        events.add("adopted", f"{instance.name} was reattached unchanged{_of_earlier_version(client, instance.name)}")
    if hanging:
        raise Unreachable("; ".join(hanging))
    for instance, state in just_started:
        goes_on = next((each for each in found.values() if each[0].role == instance.role), None)
        await half_done.end(instance, state, "which an earlier manager had just started", goes_on, accepted=False)
    for each in done.values():
        client.life.record(each.name, ProcessEvent.COMPLETED)
    for name in await launcher.end_orphans(found):
        words = f"stopped {name}, which an earlier manager had just started: what others relied on of it is not known"
        events.add(HALF_DONE, words)
    found = await _resolved(found, launcher, client, events)
    ending = [name for name, (_, state) in found.items() if state.ending]
    redundant = [*ending, *_redundant({name: each for name, each in found.items() if name not in ending})]
    for name in redundant:
        instance, state = found.pop(name)
        goes_on = None
        for other, (successor, theirs) in found.items():
            if successor.role == instance.role and other not in redundant:
                goes_on = successor, theirs
                with suppress(MidstrideError):
                    left = await have_answer(client, other, name, instance.component.stop_times.drain)
                    if left is not None:
                        events.add("note", left)
        because = "asked to end" if state.ending else "left half done"
        await half_done.end(instance, state, f"which an earlier manager had {because}", goes_on)
    for name, (instance, state) in found.items():
        if instance.role not in waiting or state.uuid == waiting[instance.role]:
            await have_answer(client, name)
    for name, (instance, observed) in found.items():
        if fenced := _fenced(observed):  # the manager, and then its successor, exited before that took over
            await client.read(name, FenceCommand(attachments=fenced, lift=True))
        # A cut that was in progress may have changed its gates and modes since it was adopted.
        found[name] = (instance, await client.observe(name))
        # This manager does not need the recordings of the earlier one.
        if inputs := list(instance.component.input_order):
            await client.undo(name, RecordCommand(inputs=inputs, on=False))
    return await _configuration(specification, targets, found, client, done.values())


def _of_earlier_version(client: ComponentClient, name: str) -> str:
    """The difference between the component's version of the control protocol and this one, if there is one."""
    spoken = client.protocol(name)
    if spoken == PROTOCOL:
        return ""
    return f"; it runs with an earlier version of Midstride, and speaks version {spoken} of the control protocol"


def _is_asked_for(instance: Instance, other: Instance, specification: Specification) -> bool:
    """Return whether ``instance``, of two that are done in an interrupted change, is that of the specification."""
    if instance.role not in specification.nodes:
        return False
    wanted = specification.component_of(instance.role)
    return wanted.same_body(instance.component) and not wanted.same_body(other.component)


async def _resolved(
    found: Mapping[str, tuple[Instance, ComponentState]], launcher: Launcher, client: ComponentClient, events: EventLog
) -> dict[str, tuple[Instance, ComponentState]]:
    """``found`` once no cut of the earlier manager is under way, without those that have exited meanwhile.

    One that is would close and open gates beside this manager's own changes: its moment may be seconds ahead. The new
    sides are first, so that they do not write when the old ones do again.
    """

    async def resolve(name: str, *, new: bool) -> None:
        with suppress(CommandRefused):  # a node without Midstride's API, whose agent has done so by itself
            await client.read(name, ResolveCutsCommand(new=new))

    resolved = dict(found)
    for ask in (partial(resolve, new=True), partial(resolve, new=False), client.observe):
        for name, (instance, state) in list(resolved.items()):
            try:
                answer = await ask(name)
            except Unreachable:  # the earlier manager had just told it to exit, or it has crashed
                handle = client.life[name].handle
                if await launcher.adopt(handle or Handle(name), instance.started, owned=handle is not None) is None:
                    events.add("gone", f"{name} is no longer running")
                    await launcher.abandon(name)
                    del resolved[name]
                    continue
                answer = await ask(name)
            resolved[name] = (instance, answer or state)
    return resolved


def _redundant(found: dict[str, tuple[Instance, ComponentState]]) -> list[str]:
    """All instances of each role but the one with the most open gates, which publishes; else the one that answers.

    A server counts only as an answer: where topics have been handed over and requests have not, those are to follow.
    One that was fenced hangs, so its successor stays.
    """
    by_role: dict[str, list[str]] = {}
    for name, (instance, _) in found.items():
        by_role.setdefault(instance.role, []).append(name)

    def rank(name: str) -> tuple[bool, int, bool, int, str]:
        instance, state = found[name]
        outputs = (topics for port, topics in state.ports.items() if not instance.component.is_service(port))
        links = [link for topics in outputs for link in topics.values()]
        fenced = bool(_fenced(state))
        return fenced, -sum(link.gate == "open" for link in links), not found[name][1].answers, len(name), name

    return [name for names in by_role.values() for name in sorted(names, key=rank)[1:]]


def _fenced(observed: ComponentState) -> list[tuple[str, str]]:
    """The fenced attachments: port and topic."""
    return [(port, topic) for port, topics in observed.ports.items() for topic, link in topics.items() if link.fenced]


async def _configuration(
    specification: Specification,
    targets: Sequence[Specification],
    found: dict[str, tuple[Instance, ComponentState]],
    client: ComponentClient,
    done: Iterable[Instance],
) -> Configuration:
    connectors = specification.connectors
    by_topic = {connector.topic: connector.name for connector in connectors.values()}
    for target in targets:
        for name, connector in target.connectors.items():
            if name not in connectors and connector.topic not in by_topic:
                connectors = connectors.set(name, connector)
                by_topic[connector.topic] = name
    context = replace(specification.context, connectors=connectors)
    attachments: list[tuple[PortRef, str]] = []
    modes: dict[FunctionalityRef, int] = {}
    for name, (instance, observed) in sorted(found.items()):
        for port, topics in observed.ports.items():
            for topic, view in topics.items():
                if topic not in by_topic:
                    continue
                if view.gate == "closed":  # the only instance of its role: otherwise its topic would stay silent
                    await client.change(name, GateCommand(port=port, topic=topic, gate="open"))
                attachments.append((PortRef(name, port), by_topic[topic]))
        modes |= reported_modes(instance.component, observed)
    return configure(context, [*(instance for instance, _ in found.values()), *done], attachments, modes)
