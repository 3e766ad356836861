"""The surroundings that ``demo`` runs in: a private folder and ROS network, and a reaper, so that nothing is left
behind.

The manager stops the processes at the end and on Ctrl-C; the reaper stops them if the demo is killed. The files are in
the repository that the demo runs from (else in the temporary folder) and are removed at the end.
"""

from __future__ import annotations

import os
import secrets
import shutil
import socket
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from midstride import backends
from midstride.backends.simulator import Simulator
from midstride.cli.example import Demo, repository
from midstride.model.specification import Specification
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.manager import Manager
from midstride.runtime.process.reaper import Reaper
from midstride.runtime.records.reports import UpReport
from midstride.runtime.workspace import Workspace

# How long a real ROS 2 process takes to start and be discovered (s); the simulator must not look faster.
COLD_START = 0.6
_MARK = "MIDSTRIDE_DEMO"


@dataclass(slots=True)
class DemoEnvironment:
    """``manager`` is the one that ends the components in the end."""

    manager: Manager
    backend: Backend
    workspace: Workspace
    folder: Path

    def use(self, specification: Specification) -> None:
        """Have the manager, which has not brought it up yet, manage this."""
        self.manager = Manager(specification, self.backend, self.workspace, self.folder)

    async def new_manager(self) -> UpReport:
        """Another manager takes over, once the one before was closed or has died."""
        self.use(self.manager.specification)
        return await self.manager.up()


@asynccontextmanager
async def demo_environment(example: Demo, backend: str) -> AsyncIterator[DemoEnvironment]:
    """Everything an example needs to run under a manager in this process. At the end, its components are stopped."""
    token = secrets.token_hex(16)
    with ExitStack() as stack:
        folder = stack.enter_context(_folder())
        workspace = Workspace(folder)
        _isolate_network(folder, backend)
        os.environ[_MARK] = token
        reaper = stack.enter_context(Reaper(_MARK, token)) if backend != "sim" else None
        platform: Backend = (
            Simulator(starting=COLD_START) if backend == "sim" else backends.make(backend, workspace, guardian=reaper)
        )
        manager = Manager(example.specification, platform, workspace, example.folder)
        environment = DemoEnvironment(manager, platform, workspace, example.folder)
        try:
            yield environment
        finally:
            try:
                await environment.manager.down()
            finally:
                await environment.manager.close()
                if isinstance(platform, Simulator):
                    await platform.shutdown()


@contextmanager
def _folder() -> Iterator[Path]:
    """A folder for the demo's files. Removes the folders of demos that were killed."""
    checkout = repository()
    if checkout is None or not os.access(checkout, os.W_OK):
        with tempfile.TemporaryDirectory(prefix="midstride-demo-", ignore_cleanup_errors=True) as name:
            yield Path(name)
        return
    root = checkout / ".midstride"
    for stale in root.glob("demo-*"):
        pid = stale.name.removeprefix("demo-")
        if not (pid.isdigit() and psutil.pid_exists(int(pid))):
            shutil.rmtree(stale, ignore_errors=True)
    folder = root / f"demo-{os.getpid()}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(mode=0o700, parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):  # another demo is running
            root.rmdir()


def _isolate_network(folder: Path, backend: str) -> None:
    """A ROS network apart from everything else on this machine, unless the user has chosen one."""
    if backend == "ros1" and "ROS_MASTER_URI" not in os.environ:
        with socket.create_server(("127.0.0.1", 0)) as server:
            os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{server.getsockname()[1]}"
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_LOG_DIR", str(folder / "ros-log"))
