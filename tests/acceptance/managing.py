"""A separate process with a manager that is killed at an agreed point of a change.

managing.py WORKSPACE down: finds the system and ends it.
managing.py WORKSPACE swap [OP NUMBER before|after]: brings the system up (or finds it again), fails if it is not valid,
and replaces the component of ``source`` by the other one. The manager is killed with -9 just before it makes the
NUMBER-th call OP of that change, or just after the NUMBER-th such call was carried out: one that is refused, as a cut
whose moment has passed, changes nothing, and is made again. OP ``write``: the NUMBER-th durable write. OP
``node_export_state``, ``node_import_state`` or ``node_set_parameters``: the NUMBER-th request to that service of a node
without the API. Each call and each write is printed, what the manager has found in the beginning, and what it has noted
in the end.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sqlite3
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from midstride import backends
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.process import reaper
from midstride.runtime.records.disk import Database, Disk, Statement
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import Command
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN
from tests.acceptance.support import BENCHMARKS, swap_specification

T = TypeVar("T")

# In the environment: a change that was interrupted is finished, not rolled back.
FINISH = "MIDSTRIDE_TEST_FINISH"


def killed_at(manager: Manager, op: str, number: int, when: str) -> None:
    """Let this process die at the ``number``-th request ``op`` from now on; after it: at the ``number``-th done."""
    client = manager._client
    send, made, done = client._send, Counter[str](), Counter[str]()

    async def counted(name: str, call: Awaitable[T]) -> T:
        made[name] += 1
        print("call", name, flush=True)
        if (name, made[name], "before") == (op, number, when):
            os.kill(os.getpid(), signal.SIGKILL)
        result = await call
        done[name] += 1
        if (name, done[name], "after") == (op, number, when):
            os.kill(os.getpid(), signal.SIGKILL)
        return result

    async def counted_command(instance: str, command: Command[Any], revision: int | None) -> Any:
        return await counted(command.name, send(instance, command, revision))

    # Not at the top: where there is only ROS 1, tests that use this module are collected, too.
    from midstride.backends.ros2.manager.node_services import RosNodeServices

    def counted_request(name: str) -> Callable[..., Awaitable[Any]]:
        ask = getattr(RosNodeServices, name)
        return lambda *arguments: counted(f"node_{name}", ask(*arguments))

    client._send = counted_command  # type: ignore[method-assign]
    for name in ("export_state", "import_state", "set_parameters"):
        setattr(RosNodeServices, name, counted_request(name))


@dataclass
class MortalDisk(Disk):
    """Calls ``at_write`` before and after each durable write."""

    at_write: Callable[[str], object] = lambda when: None

    def open(self, path: Path, schema: str) -> Database:
        return MortalDatabase(super().open(path, schema).connection, self)


class MortalDatabase(Database):
    def __init__(self, connection: sqlite3.Connection, disk: MortalDisk) -> None:
        super().__init__(connection)
        self.disk = disk

    def write(self, statements: Iterable[Statement], only_if: Statement | None = None) -> None:
        self.disk.at_write("before")
        super().write(statements, only_if)
        self.disk.at_write("after")


def killed_at_write(disk: MortalDisk, number: int, when: str) -> None:
    """Let this process die at the ``number``-th durable write from now on."""
    counts = Counter[str]()

    def at_write(moment: str) -> None:
        counts[moment] += 1
        if moment == "before":
            print("call write", flush=True)
        if (moment, counts[moment]) == (when, number):
            os.kill(os.getpid(), signal.SIGKILL)

    disk.at_write = at_write


async def found(manager: Manager) -> str:
    """What the earlier manager has left, once this one is up: as JSON, on one line."""
    instances = manager.configuration.instances
    orphans = [
        process.pid
        for process in reaper.processes()
        if process.alive
        and reaper.environment_value(process.pid, ENV_TOKEN) == manager._client.token
        and reaper.environment_value(process.pid, ENV_INSTANCE) not in instances
    ]
    changes = (await manager.history(3)).changes
    return json.dumps(
        {
            "roles": sorted(each.role for each in instances.values()),
            "source": next(each.component.name for each in instances.values() if each.role == "source"),
            "declared": manager.specification.nodes["source"].component,
            "orphans": orphans,
            "outcomes": [change.outcome for change in changes if change.command != "up"],
        }
    )


async def main(folder: Path, task: str, op: str = "", number: str = "0", when: str = "") -> int:
    workspace = Workspace(folder)
    saved = StateStore(workspace.state).load()
    specification = swap_specification() if saved is None else saved.specification
    backend = backends.make("ros2", workspace)
    disk = MortalDisk()
    options = SystemOptions(finish_interrupted=FINISH in os.environ)
    manager = Manager(specification, backend, workspace, BENCHMARKS, options=options, disk=disk)
    await manager.up()
    try:
        status = await manager.status()
        if not status.valid:
            print(f"not valid: {status.violations} {status.instances}")
            return 1
        print("found", await found(manager), flush=True)
        if task == "down":
            await manager.down()
        else:
            (now,) = (each.component.name for each in manager.configuration.instances.values() if each.role == "source")
            killed_at(manager, op, int(number), when)
            killed_at_write(disk, int(number) if op == "write" else 0, when)
            other = "Source" if now == "OtherSource" else "OtherSource"
            outcome = await manager.change(PlanRequest(replace=(("source", other),)))
            print(outcome.outcome, outcome.because)
    finally:
        for event in manager.log():
            if event.kind in ("note", "killed", "gone"):
                print("noted", event.words, flush=True)
        await manager.close()
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main(Path(sys.argv[1]), *sys.argv[2:])))
