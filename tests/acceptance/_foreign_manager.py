"""A manager in a process of its own, which is killed during a change: `_foreign_manager.py FOLDER COMPONENT SECONDS`.

It brings the system of tests.acceptance.foreign_support up, or finds it again, and replaces the talker by a COMPONENT;
SECONDS after it has begun with that, it is killed. With `down` as the component, it ends the system.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.state_store import StateStore
from midstride.runtime.workspace import Workspace
from tests.acceptance.foreign_support import manager_of


async def main(folder: Path, component: str, seconds: float) -> None:
    saved = StateStore(Workspace(folder / "system").state).load()
    specification = load(folder / "swaps.stride").require() if saved is None else saved.specification
    manager = manager_of(specification, folder)
    await manager.up()
    try:
        status = await manager.status()
        assert status.valid, status
        if component == "down":
            await manager.down()
        else:
            asyncio.get_running_loop().call_later(seconds, os.kill, os.getpid(), signal.SIGKILL)
            outcome = await manager.change(PlanRequest(replace=(("talker", component),)))
            print(outcome.outcome, outcome.because, flush=True)
            await asyncio.sleep(60)
    finally:
        await manager.close()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])))
