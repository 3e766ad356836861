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
from midstride.plan.request import Request
from midstride.runtime.manager import Manager
from midstride.runtime.recovery import specification_of
from midstride.runtime.workspace import Workspace
from midstride.wire.messages import Command, Reply
from tests.acceptance.support import BENCHMARKS, swap_specification


def killed_at(backend: Any, op: str, number: int, when: str) -> None:
    """Let this process die at the ``number``-th call ``op`` from now on."""
    call, counts = backend.call, Counter[str]()

    async def counted(instance: str, command: Command, timeout: float) -> Reply:
        counts[command.op] += 1
        last = (command.op, counts[command.op]) == (op, number)
        print("call", command.op, flush=True)
        if last and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        reply: Reply = await call(instance, command, timeout)
        if last:
            os.kill(os.getpid(), signal.SIGKILL)
        return reply

    backend.call = counted


async def main(folder: Path, task: str, op: str = "", number: str = "0", when: str = "") -> int:
    workspace = Workspace(folder)
    state = workspace.load()
    specification = swap_specification() if state is None else specification_of(state)
    backend = backends.make("ros2", logs=workspace.logs)
    manager = Manager(specification, backend, workspace, BENCHMARKS)
    await manager.up()
    try:
        status = await manager.status()
        if not status["valid"]:
            print(f"not valid: {status['violations']} {status['components']}")
            return 1
        if task == "down":
            await manager.down()
        else:
            (now,) = (each.component.name for each in manager.configuration.instances.values() if each.role == "source")
            killed_at(backend, op, int(number), when)
            other = "Source" if now == "OtherSource" else "OtherSource"
            outcome = await manager.change(Request(replace=(("source", other),)))
            print(outcome["outcome"], outcome["because"])
    finally:
        await manager.close()
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main(Path(sys.argv[1]), *sys.argv[2:])))
