"""A separate process with a manager, which is killed: `_container_manager.py FOLDER DOING SECONDS`.

It brings the system of tests.acceptance.test_shared_containers up, or finds it again, and is killed so many SECONDS
after it has begun with what it is DOING: `up`; `alone`, where one node leaves its container; `repack`, where all move;
or `crash`, where the container is killed and restored.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
from pathlib import Path

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from tests.acceptance.foreign_support import manager_of


async def main(folder: Path, doing: str, seconds: float) -> None:
    saved = StateStore(Workspace(folder / "system").state).load()
    specification = load(folder / "grouped.stride").require() if saved is None else saved.specification
    manager = manager_of(specification, folder)
    # From another thread, so at any moment of what the manager does.
    killing = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGKILL))
    if doing == "up":
        killing.start()
    await manager.up()
    if doing == "crash":
        (pid,) = {each.pid for each in (await manager.status()).instances if each.role == "front/other"}
        assert pid is not None
        killing.start()
        os.kill(pid, signal.SIGKILL)
    elif doing != "up":
        killing.start()
        what = "front/talker" if doing == "alone" else "front/pipeline"
        await manager.change(PlanRequest(restart=(what,), with_other_nodes=True))
    await asyncio.sleep(60)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])))
