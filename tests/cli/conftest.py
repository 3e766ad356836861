"""The command as its users start it: a process, with a runtime folder of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from midstride.cli import main
from midstride.runtime.reaper import process_info
from midstride.runtime.state_store import SavedState, StateStore
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


@dataclass(frozen=True)
class Done:
    """What a command printed, and its exit status."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@dataclass
class Midstride:
    """Runs ``midstride`` with a runtime folder of its own."""

    runtime: Path
    environment: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        inherited = {name: value for name, value in os.environ.items() if name != "MIDSTRIDE_DEMO"}
        self.environment = {**inherited, "XDG_RUNTIME_DIR": str(self.runtime), **self.environment}

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "midstride", *words]

    def __call__(self, *words: str, timeout: float = 60, **environment: str) -> Done:
        done = subprocess.run(
            self.command(*words),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
            cwd=ROOT,
            env={**self.environment, **environment},
        )
        return Done(done.returncode, done.stdout, done.stderr)

    def start(self, *words: str) -> subprocess.Popen[str]:
        """A command that goes on; its standard error comes with its standard output."""
        return subprocess.Popen(
            self.command(*words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=ROOT,
            env=self.environment,
        )

    def manager(self, system: str) -> int:
        """The process of a running manager."""
        return int((self.runtime / "midstride" / system / "lock").read_text())

    def components(self, system: str) -> list[int]:
        """The processes of a running system's components, by what its manager has written."""
        pids = [entry.handle and entry.handle.pid for entry in self.saved(system).instances]
        assert all(pids)
        return [pid for pid in pids if pid]

    def saved(self, system: str) -> SavedState:
        """What the manager of a system has written for the next one."""
        state = StateStore(self.runtime / "midstride" / system / "state.db").load()
        assert state is not None
        return state

    def down(self) -> None:
        """End whatever runs here."""
        for state in self.runtime.glob("midstride/*/state.db"):
            done = self("down", "--system", state.parent.name)
            assert done.status == 0, done.err


@contextmanager
def unwritten(midstride: Midstride) -> Iterator[subprocess.Popen[bytes]]:
    """A component of the talker's system that a manager started right before it was killed."""
    token = midstride.saved("talker").token
    environment = {**os.environ, ENV_TOKEN: token, ENV_INSTANCE: "late"}
    with subprocess.Popen(["sleep", "600"], env=environment, start_new_session=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Any:
    """The command line in this process: its exit status, and what it printed."""

    def run(*words: object) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def midstride() -> Iterator[Midstride]:
    yield from running()


def running() -> Iterator[Midstride]:
    # Sockets have short paths, and pytest's own temporary folders long ones.
    folder = Path(tempfile.mkdtemp(prefix="ms"))
    command = Midstride(folder)
    try:
        yield command
        command.down()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def nothing_lost(swaps: list[dict[str, Any]]) -> bool:
    """What the middleware cannot tell is None: only from kilted on does it tell whose message one is."""
    allowed = {0, None} if "MIDSTRIDE_ROS2_ON_PATHS" in os.environ else {0}
    return bool(swaps) and all({swap["lost"], swap["duplicates"]} <= allowed for swap in swaps)


def alive(pid: int) -> bool:
    info = process_info(pid)
    return info is not None and info.alive
