"""The examples under a manager on the simulator, for tests."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

from midstride.backends.simulator import Simulator
from midstride.model.document import specification_from_document
from midstride.model.specification import Specification
from midstride.plan.request import Request
from midstride.runtime.manager import Manager
from midstride.runtime.verifying import Verifier
from midstride.runtime.workspace import Workspace
from midstride.wire.messages import Command

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

T = TypeVar("T")


def example(name: str) -> Specification:
    return specification_from_document(json.loads((EXAMPLES / name / f"{name}.json").read_text()))


def replace(role: str, component: str, strategy: str = "minimal") -> Request:
    return Request(replace=((role, component),), strategy=strategy)


def managed(
    name: str,
    folder: Path,
    body: Callable[[Manager, Simulator], Awaitable[T]],
    simulator: Simulator | None = None,
    specification: Specification | None = None,
    verifier: Verifier | None = None,
) -> T:
    """Bring the example up in virtual time, run ``body``, and shut everything down."""
    simulator = simulator or Simulator()

    async def main() -> T:
        workspace = Workspace(folder)
        manager = Manager(specification or example(name), simulator, workspace, EXAMPLES / name, verifier)
        await manager.up()
        try:
            return await body(manager, simulator)
        finally:
            await manager.close()

    return simulator.run(main())


async def kept(workspace: Workspace, simulator: Simulator, port: str) -> int:
    """How many receipts the input ``port`` keeps: 64 at most, unless it records."""
    component, _, name = port.partition(".")
    state = workspace.load()
    assert state is not None
    reply = await simulator.call(component, Command("records", {"input": name}, "asked", state["token"]), 3.0)
    return len(reply.result["rows"])


async def snapshot(manager: Manager, simulator: Simulator) -> dict[str, Any]:
    """All that a change that is taken back must leave as it was: components, gates, graph, model."""
    own = {}
    for name in sorted(simulator.processes):
        state = await manager.peek(name)
        own[name] = {
            "modes": {functionality: view["mode"] for functionality, view in state["functionalities"].items()},
            "gates": {
                f"{port} {topic}": view["gate"]
                for port, topics in state["ports"].items()
                for topic, view in topics.items()
            },
            "parameters": state["parameters"],
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
