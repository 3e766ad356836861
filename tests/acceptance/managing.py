"""A manager in a process of its own that is killed at an agreed point of a change.

managing.py WORKSPACE COMPONENT POINT: brings the system up (or finds it again), replaces ``source``
by COMPONENT, and is killed with -9 at the call number POINT of the change, before the call is made
(``7``) or after it was answered (``7+``). ``-``: it is not killed.
Each call is printed. ``down`` as COMPONENT ends the system.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path
from typing import Any

from midstride import backends
from midstride.plan.request import Request
from midstride.runtime.manager import Manager
from midstride.runtime.recovery import specification_of
from midstride.runtime.workspace import Workspace
from midstride.wire.messages import Command, Reply
from tests.acceptance.support import BENCHMARKS, swap_specification


def killed_at(backend: Any, point: str) -> None:
    """Have the backend's ``point``th call from now on be the last thing this process does."""
    at, after = (-1, False) if point == "-" else (int(point.rstrip("+")), point.endswith("+"))
    call, count = backend.call, 0

    async def counted(instance: str, command: Command, timeout: float) -> Reply:
        nonlocal count
        mine, count = count, count + 1
        print("call", command.op, flush=True)
        if mine == at and not after:
            os.kill(os.getpid(), signal.SIGKILL)
        reply: Reply = await call(instance, command, timeout)
        if mine == at:
            os.kill(os.getpid(), signal.SIGKILL)
        return reply

    backend.call = counted


async def main(folder: Path, component: str, point: str) -> int:
    workspace = Workspace(folder)
    state = workspace.load()
    specification = swap_specification() if state is None else specification_of(state)
    backend = backends.make("ros2", workspace)
    manager = Manager(specification, backend, workspace, BENCHMARKS)
    await manager.up()
    try:
        status = await manager.status()
        if not status.valid:
            print(f"not valid: {status.violations} {status.components}")
            return 1
        if component == "down":
            await manager.down()
        elif component != "nothing":
            killed_at(backend, point)
            outcome = await manager.change(Request(replace=(("source", component),)))
            print(outcome.outcome, outcome.because)
    finally:
        await manager.close()
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main(Path(sys.argv[1]), sys.argv[2], sys.argv[3])))
