"""A manager in a process of its own that is killed at an agreed point of a change.

managing.py WORKSPACE down: finds the system and ends it.
managing.py WORKSPACE swap [OP NUMBER before|after]: brings the system up (or finds it again), fails if it is not valid,
and replaces the component of ``source`` by the other one. The manager is killed with -9 just before it makes the
NUMBER-th call OP of that change, or just after that call was answered. Each call is printed.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from midstride import backends
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.state_store import StateStore
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import Command
from tests.acceptance.support import BENCHMARKS, swap_specification


def killed_at(manager: Manager, op: str, number: int, when: str) -> None:
    """Let this process die at the ``number``-th request ``op`` from now on."""
    client = manager._client
    send, counts = client._send, Counter[str]()

    async def counted(instance: str, command: Command[Any], revision: int | None) -> Any:
        counts[command.name] += 1
        last = (command.name, counts[command.name]) == (op, number)
        print("call", command.name, flush=True)
        if last and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        result = await send(instance, command, revision)
        if last:
            os.kill(os.getpid(), signal.SIGKILL)
        return result

    client._send = counted  # type: ignore[method-assign]


async def main(folder: Path, task: str, op: str = "", number: str = "0", when: str = "") -> int:
    workspace = Workspace(folder)
    saved = StateStore(workspace.state).load()
    specification = swap_specification() if saved is None else saved.specification
    backend = backends.make("ros2", workspace)
    manager = Manager(specification, backend, workspace, BENCHMARKS)
    await manager.up()
    try:
        status = await manager.status()
        if not status.valid:
            print(f"not valid: {status.violations} {status.components}")
            return 1
        if task == "down":
            await manager.down()
        else:
            (now,) = (each.component.name for each in manager.configuration.instances.values() if each.role == "source")
            killed_at(manager, op, int(number), when)
            other = "Source" if now == "OtherSource" else "OtherSource"
            outcome = await manager.change(PlanRequest(replace=(("source", other),)))
            print(outcome.outcome, outcome.because)
    finally:
        await manager.close()
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main(Path(sys.argv[1]), *sys.argv[2:])))
