"""``up --replace-manager``: a manager of this version takes over from the one that runs; the components stay."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from contextlib import suppress
from typing import Final

from midstride import backends
from midstride.cli.client import Client
from midstride.errors import ManagerBusy, ManagerError
from midstride.foreign.page import GATES_FOLDER, PAGE, require_usable
from midstride.runtime.hosts.earlier_hosts import faults_on_hosts
from midstride.runtime.records.journal_records import require_readable
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.restore.earlier_system import require_same_platform, require_spoken
from midstride.runtime.workspace import Workspace
from midstride.wire.sockets import SocketFolder

# How long the earlier manager may take to end, once it is told to (s).
END_TIMEOUT: Final = 30.0
POLL: Final = 0.02


def end_earlier(workspace: Workspace, backend: str) -> None:
    """End the manager of ``workspace``, if one runs, once it is known that this process can manage what it leaves.

    Raises MidstrideError: ManagerBusy where it is at work, ManagerError where it does not end in time.
    """
    if (earlier := workspace.manager()) is None:
        return
    saved = StateStore(workspace.state).load()
    if saved is None:
        raise ManagerError(f"the manager of {workspace.name} (process {earlier}) has not begun to start it; try again")
    require_manageable(saved, workspace, backend)
    _require_idle(workspace, earlier)
    with suppress(ProcessLookupError):
        os.kill(earlier, signal.SIGTERM)
    end = time.monotonic() + END_TIMEOUT
    while workspace.manager() == earlier:
        if time.monotonic() > end:
            raise ManagerError(
                f"the manager of {workspace.name} (process {earlier}) was asked to exit and has not within "
                f"{END_TIMEOUT:g} s. `kill -9 {earlier}` ends it alone, and its components keep running; then "
                "`midstride up FILE` takes over"
            )
        time.sleep(POLL)


def require_manageable(saved: SavedState, workspace: Workspace, backend: str) -> None:
    """Raises MidstrideError where a manager of this version, started here, could not manage what is ``saved``."""
    if backend == "sim" and saved.backend == backend:
        raise ManagerError(
            f"{workspace.name} runs in the simulator, whose components live in the process of the manager and end "
            "with it: `midstride down`, then `midstride up`"
        )
    require_readable(workspace.journal)
    require_usable(workspace.components / GATES_FOLDER / PAGE)
    middleware_settings = saved.options.middleware_settings
    platform = backends.make(backend, workspace, middleware_settings=middleware_settings)
    require_same_platform(saved, workspace.name, backend, platform.reach())
    asyncio.run(require_spoken(saved, SocketFolder(workspace.components)))
    if faults := asyncio.run(faults_on_hosts(saved, platform)):
        raise ManagerError("; ".join(faults))


def _require_idle(workspace: Workspace, earlier: int) -> None:
    """Raises ManagerBusy while the manager starts the system or changes it: to end it would roll that back."""
    state = Client(workspace.socket).activity()
    if state is not None:
        raise ManagerBusy(f"the manager of {workspace.name} (process {earlier}) {state}; try again when that is done")
