"""What ``demo`` runs on: a folder, a network and a guardian of its own, so that nothing is left behind.

However the demo ends, its processes end: in order at its end and on Ctrl-C, by the guardian where it
was killed. Its files are in the repository it runs from (else in the temporary folder), and go with it.
"""

from __future__ import annotations

import os
import secrets
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from midstride import backends
from midstride.backends.simulator import Simulator
from midstride.cli.example import Demo, repository
from midstride.runtime.backend import Backend
from midstride.runtime.manager import Manager
from midstride.runtime.reaper import Reaper
from midstride.runtime.workspace import Workspace

# What a real process of ROS 2 takes to start and to be found (s): the simulated ones shall not look better.
COLD_START = 0.6
_MARK = "MIDSTRIDE_DEMO"


@dataclass(frozen=True, slots=True)
class DemoEnvironment:
    manager: Manager
    backend: Backend
    workspace: Workspace


@contextmanager
def demo_environment(example: Demo, backend: str) -> Iterator[DemoEnvironment]:
    """Everything an example needs to run under a manager in this process. What is left at the end is ended."""
    token = secrets.token_hex(16)
    with ExitStack() as stack:
        folder = stack.enter_context(_folder())
        workspace = Workspace(folder)
        _own_network(folder, backend)
        os.environ[_MARK] = token
        guardian = stack.enter_context(Reaper(_MARK, token)) if backend != "sim" else None
        platform: Backend = (
            Simulator(starting=COLD_START) if backend == "sim" else backends.make(backend, workspace, guardian=guardian)
        )
        yield DemoEnvironment(Manager(example.specification, platform, workspace, example.folder), platform, workspace)


@contextmanager
def _folder() -> Iterator[Path]:
    """A folder for the demo's files; those of demos that were killed are swept up."""
    checkout = repository()
    root = None if checkout is None else checkout / ".midstride"
    try:
        if root is None:
            raise OSError
        root.mkdir(exist_ok=True)
        folder = root / f"demo-{os.getpid()}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(mode=0o700)
    except OSError:  # no repository around, or one that may not be written to
        root, folder = None, Path(tempfile.mkdtemp(prefix="midstride-demo-"))
    if root is not None:
        _sweep(root)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if root is not None:
            with suppress(OSError):  # another demo is running
                root.rmdir()


def _sweep(root: Path) -> None:
    for left in root.glob("demo-*"):
        pid = left.name.removeprefix("demo-")
        if not (pid.isdigit() and psutil.pid_exists(int(pid))):
            shutil.rmtree(left, ignore_errors=True)


def _own_network(folder: Path, backend: str) -> None:
    """A ROS network apart from whatever runs on this machine, unless the user has chosen one."""
    if backend == "ros1" and "ROS_MASTER_URI" not in os.environ:
        with socket.create_server(("127.0.0.1", 0)) as door:
            os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{door.getsockname()[1]}"
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_LOG_DIR", str(folder / "ros-log"))
