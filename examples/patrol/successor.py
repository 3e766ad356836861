"""A manager in a separate process, which the demonstration kills: ``python3 successor.py WORKSPACE BACKEND``.

It takes over the running robot, says what that came to, and manages it until it is killed.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from midstride import backends
from midstride.runtime.manager import Manager
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace


async def main(folder: Path, backend: str) -> None:
    workspace = Workspace(folder)
    saved = StateStore(workspace.state).load()
    if saved is None:
        raise SystemExit(f"nothing runs in {folder}")
    manager = Manager(saved.specification, backends.make(backend, workspace), workspace, Path(__file__).parent)
    print((await manager.up()).outcome, flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2]))
