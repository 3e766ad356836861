"""Finding a running system again: what an earlier manager left, and what is true of it now.

The state store has what the earlier manager believed; each component reports what it is. Where they
differ, the component is right. What a killed manager left half done (a second instance of a role
behind its gate) is ended here, so that the configuration is one the model knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from midstride.errors import MidstrideError
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.specification import Specification
from midstride.runtime.backend import Handle
from midstride.runtime.component_client import ComponentClient
from midstride.runtime.launcher import Launcher
from midstride.runtime.state_store import SavedInstance
from midstride.wire.commands import GateCommand, RecordCommand
from midstride.wire.state import ComponentState

Tell = Callable[[str, str], object]


async def recover(
    saved: Sequence[SavedInstance],
    specification: Specification,
    launcher: Launcher,
    client: ComponentClient,
    tell: Tell,
) -> Configuration:
    """The configuration of what still runs. Ends half-started components; never touches what works."""
    found: dict[str, tuple[Instance, ComponentState]] = {}
    for entry in saved:
        instance, handle = entry.instance, entry.handle
        state = await launcher.adopt(handle or Handle(instance.name), own=handle is not None)
        if state is None:
            tell("gone", f"{instance.name} is no longer running")
            await launcher.abandon(instance.name)
            continue
        found[instance.name] = (instance, state)
        tell("adopted", f"{instance.name} was reattached unchanged")
    for name in await launcher.end_orphans(found):
        tell("ended", f"ended {name}, which an earlier manager had just started")
    for name in _half_done(found):
        tell("ended", f"ended {name}, which an earlier manager had left half done")
        await _end(found.pop(name)[0].name, launcher, client)
    for name, (instance, _) in found.items():
        # A cut that was under way may have been settled since it was looked at.
        found[name] = (instance, await client.observe(name))
        # What was being recorded for the earlier manager is of no use to this one.
        if inputs := list(instance.component.input_order):
            await client.undo(name, RecordCommand(inputs=inputs, on=False))
    return await _configuration(specification, found, client)


def _half_done(found: dict[str, tuple[Instance, ComponentState]]) -> list[str]:
    """Instances beside another one of their role that serves its topics while they do not."""
    by_role: dict[str, list[str]] = {}
    for name, (instance, _) in found.items():
        by_role.setdefault(instance.role, []).append(name)
    half: list[str] = []
    for names in by_role.values():
        ranked = sorted(names, key=lambda name: (-_open_gates(found[name][1]), len(name), name))
        half.extend(ranked[1:])
    return half


def _open_gates(observed: ComponentState) -> int:
    return sum(link.gate == "open" for topics in observed.ports.values() for link in topics.values())


async def _end(name: str, launcher: Launcher, client: ComponentClient) -> None:
    try:
        await launcher.end(name)
    except MidstrideError:
        client.forget(name)


async def _configuration(
    specification: Specification, found: dict[str, tuple[Instance, ComponentState]], client: ComponentClient
) -> Configuration:
    by_topic = {connector.topic: connector.name for connector in specification.connectors.values()}
    attachments: list[tuple[PortRef, str]] = []
    modes: dict[FunctionalityRef, int] = {}
    for name, (instance, observed) in sorted(found.items()):
        for port, topics in observed.ports.items():
            for topic, view in topics.items():
                if topic not in by_topic:
                    continue
                if view.gate == "closed":  # the last one of its role: its topic is silent, so it may speak again
                    await client.change(name, GateCommand(port=port, topic=topic, gate="open"))
                attachments.append((PortRef(name, port), by_topic[topic]))
        for functionality, current in observed.functionalities.items():
            index = instance.component.functionalities[functionality].mode_index(current.mode)
            modes[FunctionalityRef(name, functionality)] = index
    return configure(specification.context, [instance for instance, _ in found.values()], attachments, modes)
