"""A robot of two hosts: a system over SSH and real ROS 2, in network namespaces, with a link that can be cut."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from midstride.runtime.process.reaper import process_info
from tests.acceptance.support import ended
from tests.cli.conftest import Done
from tests.hosts.slow_link import Slow
from tests.hosts.two_hosts import TwoHosts, two_hosts

SECONDS = 40.0


@dataclass
class Robot:
    """A system whose files are in ``near`` on the manager's host, and in ``far`` on the host `arm`; and the command."""

    hosts: TwoHosts
    folder: Path
    system: str
    text: str

    def __call__(self, *words: str, timeout: float = 90.0) -> Done:
        done = subprocess.run(
            self.command(*words), capture_output=True, text=True, timeout=timeout, env=self.environment, cwd="/"
        )
        return Done(done.returncode, done.stdout, done.stderr)

    def command(self, *words: str) -> list[str]:
        return self.hosts.inside(sys.executable, "-m", "midstride", *words)

    def begin(self, *words: str) -> subprocess.Popen[str]:
        """The command while it runs."""
        pipe = subprocess.PIPE
        return subprocess.Popen(
            self.command(*words), stdout=pipe, stderr=pipe, text=True, env=self.environment, cwd="/"
        )

    @property
    def environment(self) -> dict[str, str]:
        return {
            **os.environ,
            "XDG_RUNTIME_DIR": str(self.folder / "run"),
            "MIDSTRIDE_SSH_CONFIG": str(self.hosts.config),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        }

    @property
    def file(self) -> str:
        path = self.folder / "near" / "two.stride"
        path.write_text(self.text)
        return str(path)

    @property
    def status(self) -> Any:
        done = self("status", "--json")
        assert done.out, done.err
        return done.json

    def instance(self, role: str) -> Any:
        (found,) = (each for each in self.status["instances"] if each["role"] == role)
        return found

    def modes(self, role: str) -> list[str]:
        return [each["mode"] for each in self.instance(role)["functionalities"]]

    def programs(self, name: str = ".py") -> list[int]:
        """The processes in the folders of the programs that run one with this end of its name, by number."""
        found = []
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (path / "cmdline").read_bytes().decode(errors="replace").split("\0")
                if any(each.endswith(name) for each in words[1:]) and (path / "cwd").resolve().parent == self.folder:
                    found.append(int(path.name))
        return sorted(found)

    def is_sound(self, nodes: int) -> bool:
        """Whether the system is up and valid, with so many nodes, its host reached, and no other processes."""
        status = self.status
        return (
            status["condition"]["state"] == "up"
            and status["valid"]
            and all(each["connected"] for each in status["hosts"])
            and len(status["instances"]) == nodes
            and set(self.programs()) == {each["pid"] for each in status["instances"]}
        )

    def until(self, condition: Callable[[], bool], what: str, seconds: float = SECONDS) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self('status').out} {self('log').out}"
            time.sleep(0.2)

    @property
    def workspace(self) -> Path:
        """The one of the host process."""
        return self.folder / "far" / ".midstride" / f"{self.system}.arm"

    @property
    def host_process(self) -> int:
        return int((self.workspace / "lock").read_text())

    def host_runs(self) -> bool:
        return (self.workspace / "host.sock").exists()

    @property
    def manager(self) -> int:
        return int((self.folder / "run" / "midstride" / self.system / "lock").read_text())


@contextlib.contextmanager
def robots(files: Path, text: str, slow: Slow | None = None) -> Iterator[Robot]:
    """The system of ``text`` while the context is open, on two hosts that both have the ``files``.

    ``slow``: what the link between them does to frames, if it is not a cable.

    Where hosts cannot be had, the test is skipped.
    """
    system = text.split("system ", 1)[1].split()[0]
    folder = Path(tempfile.mkdtemp(prefix="ms-"))
    try:
        with ended(), two_hosts(folder, slow) as hosts:
            (folder / "run").mkdir(mode=0o700)
            for name in ("near", "far"):
                shutil.copytree(files, folder / name)
            declared = text.replace(f"system {system}\n", f"system {system}\n{hosts.declaration(folder / 'far')}")
            robot = Robot(hosts, folder, system, declared)
            try:
                yield robot
            finally:
                robot("down", timeout=60)
                lock = robot.workspace / "lock"
                _end(int(lock.read_text()) if lock.exists() else None)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _end(pid: int | None) -> None:
    """End a host process of this test."""
    if pid is not None and (info := process_info(pid)) is not None and info.alive:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
        if b"_host" in command:
            os.kill(pid, signal.SIGTERM)
