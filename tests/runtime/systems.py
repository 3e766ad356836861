"""The examples under a manager on the simulator, for tests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from pathlib import Path
from typing import Any, TypeVar

from midstride.backends.simulator import Simulator
from midstride.lang import load
from midstride.model.contract import DEFAULT_QOS
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.change.runtime_verification import Verifier
from midstride.runtime.manager import Manager
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.records.reports import UpReport
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.workspace import Workspace
from midstride.wire.channel import Channel, result_of
from midstride.wire.commands import Command, RecordsCommand
from midstride.wire.frames import Reply

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

T = TypeVar("T")


def example(name: str, directory: Path | None = None) -> Specification:
    return load((directory or EXAMPLES / name) / f"{name}.stride").require()


def rewritten(name: str, folder: Path, rewrite: Callable[[str, str], str]) -> Path:
    """The example's programs and specification in ``folder``, each as ``rewrite(its name, its text)`` has it."""
    folder.mkdir()
    for file in (EXAMPLES / name).iterdir():
        if file.suffix in {".py", ".stride"}:
            (folder / file.name).write_text(rewrite(file.name, file.read_text()))
    return folder


def slow_filter(folder: Path) -> Path:
    """The filter's example at 20 Hz: for tests that bring it up a hundred times."""
    return rewritten("filter", folder, lambda _, text: text.replace("200", "20"))


# A talker that says the state it has, and hands it on.
_STATEFUL = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
state = {own!r}
talk.set_normal_mode(lambda: out.write(String(data=state)), rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)

@comp.on_export_state
def export():
    return state.encode()

@comp.on_import_state
def take_up(given):
    global state
    state = given.decode() + "+"

comp.start()
"""


def stateful_talkers(folder: Path) -> Specification:
    """The talker's example with other programs, written to ``folder``: each says whose state it has taken up."""
    specification = example("talker")
    components = specification.components
    for component, own in (("Talker", "the old one's"), ("NewTalker", "the new one's")):
        script = folder / f"{component}.py"
        script.write_text(_STATEFUL.format(own=own))
        components = components.set(component, changed(components[component], run=f"python3 {script}"))
    return changed(specification, components=components)


async def last_said(simulator: Simulator, topic: str = "/chatter") -> str:
    """What is said on ``topic``, by default the talker's, a second later."""
    reader = simulator.network.create_reader(
        simulator.processes["listener"], topic, "std_msgs/msg/String", DEFAULT_QOS, lambda: None
    )
    await asyncio.sleep(1)
    said: str = reader.queue[-1][0].data
    return said


def replace(role: str, component: str, strategy: str = "minimal") -> PlanRequest:
    return PlanRequest(replace=((role, component),), strategy=strategy)


def managed(
    name: str,
    folder: Path,
    body: Callable[[Manager, Simulator], Awaitable[T]],
    simulator: Simulator | None = None,
    specification: Specification | None = None,
    verifier: Verifier | None = None,
    directory: Path | None = None,
) -> T:
    """Bring the example up in virtual time, run ``body``, and shut everything down."""
    simulator = simulator or Simulator()

    async def main() -> T:
        workspace = Workspace(folder)
        programs = directory or EXAMPLES / name
        manager = Manager(specification or example(name, programs), simulator, workspace, programs, verifier)
        await manager.up()
        try:
            return await body(manager, simulator)
        finally:
            await manager.close()

    return simulator.run(main())


def saved(workspace: Workspace) -> SavedState:
    """What the manager of ``workspace`` has written down for the next one."""
    state = StateStore(workspace.state).load()
    assert state is not None
    return state


async def request(
    workspace: Workspace, simulator: Simulator, instance: str, command: Command[Any], revision: int | None = None
) -> Reply:
    """The reply to a request of another client with the system's token."""
    transport = simulator.transport
    channel = await Channel.open(transport, transport.address(instance), saved(workspace).token, timeout=3.0)
    try:
        return await channel.request(command, revision=revision, timeout=3.0)
    finally:
        channel.close()


async def kept(workspace: Workspace, simulator: Simulator, port: str) -> int:
    """How many receipts the input ``port`` keeps: 64 at most, unless it records."""
    instance, _, name = port.partition(".")
    command = RecordsCommand(input=name)
    return len(result_of(await request(workspace, simulator, instance, command), command).rows)


async def snapshot(manager: Manager, simulator: Simulator) -> dict[str, Any]:
    """All that a change that is taken back must leave as it was: components, gates, graph, model."""
    own = {}
    for name in sorted(simulator.processes):
        state = await manager.peek(name)
        own[name] = {
            "modes": {functionality: view.mode for functionality, view in state.functionalities.items()},
            "gates": {
                f"{port} {topic}": link.gate for port, topics in state.ports.items() for topic, link in topics.items()
            },
            "parameters": state.parameters,
        }
    endpoints = await simulator.endpoints()
    return {
        "components": own,
        "nodes": sorted(endpoints.nodes),
        "publishers": sorted(endpoints.publishers),
        "subscribers": sorted(endpoints.subscribers),
        "configuration": manager.configuration,
        "specification": manager.specification,
    }


def up(
    specification: Specification,
    folder: Path,
    programs: Path,
    body: Callable[[Manager, Simulator, UpReport], Awaitable[None]],
    options: SystemOptions = NO_OPTIONS,
    prepare: Callable[[Simulator], None] = lambda _: None,
) -> None:
    """Bring the system up in virtual time, and run ``body`` with what that reported."""
    simulator = Simulator()

    async def main() -> None:
        manager = Manager(specification, simulator, Workspace(folder), programs, options=options)
        prepare(simulator)
        try:
            await body(manager, simulator, await manager.up())
        finally:
            await manager.close()

    simulator.run(main())
