"""The command with a private runtime folder: as a process, or in this process where only its output matters."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from midstride.cli import main
from midstride.runtime.process.reaper import process_info
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN
from tests.backends.ros2_support import publishers_are_identified

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


@dataclass(frozen=True)
class Done:
    """The output of a command, and its exit status."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


# Commands that only talk to the manager or compute: they run in this process, which saves the start of an interpreter.
IN_PROCESS = {
    "add",
    "apply",
    "diff",
    "export",
    "history",
    "lock",
    "log",
    "logs",
    "param",
    "plan",
    "remove",
    "replace",
    "report",
    "restart",
    "rollback",
    "status",
    "unlock",
    "verify",
    "why",
}


@dataclass
class Midstride:
    """Runs ``midstride`` with a private runtime folder."""

    runtime: Path
    environment: dict[str, str] = field(default_factory=dict)
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        inherited = {name: value for name, value in os.environ.items() if name != "MIDSTRIDE_DEMO"}
        self.environment = {**inherited, "XDG_RUNTIME_DIR": str(self.runtime), **self.environment}

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "midstride", *words]

    def __call__(self, *words: str, timeout: float = 60, **environment: str) -> Done:
        if not IN_PROCESS & set(words[:2]):
            return self.process(*words, timeout=timeout, **environment)
        out, err = io.StringIO(), io.StringIO()
        with (
            mock.patch.dict(os.environ, {**self.environment, **environment}, clear=True),
            open(os.devnull) as nothing,
            mock.patch.object(sys, "stdin", nothing),
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            status = main(words)
        return Done(status, out.getvalue(), err.getvalue())

    def process(self, *words: str, timeout: float = 60, **environment: str) -> Done:
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
        """A command that keeps running, at most until the test ends; its standard error is merged into its output."""
        process = subprocess.Popen(
            self.command(*words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=ROOT,
            env=self.environment,
        )
        self.started.append(process)
        return process

    def manager(self, system: str) -> int:
        """The process of a running manager."""
        return int((self.runtime / "midstride" / system / "lock").read_text())

    def components(self, system: str) -> list[int]:
        """The processes of a running system's components, from the manager's state file."""
        pids = [entry.handle and entry.handle.pid for entry in self.saved(system).instances]
        assert all(pids)
        return [pid for pid in pids if pid]

    def saved(self, system: str) -> SavedState:
        """The state that the manager of a system has saved."""
        state = StateStore(self.runtime / "midstride" / system / "state.db").load()
        assert state is not None
        return state

    def down(self) -> None:
        """Stop all systems of this folder."""
        for state in self.runtime.glob("midstride/*/state.db"):
            done = self("down", "--system", state.parent.name)
            assert done.status == 0, done.err


@contextmanager
def unwritten(midstride: Midstride) -> Iterator[subprocess.Popen[bytes]]:
    """A component that a manager started right before it was killed, and did not record."""
    token = midstride.saved("talker").token
    environment = {**os.environ, ENV_TOKEN: token, ENV_INSTANCE: "late"}
    with subprocess.Popen(["sleep", "600"], env=environment, start_new_session=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Any:
    """The command line in this process: its exit status, standard output and standard error."""

    def run(*words: object) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def midstride() -> Iterator[Midstride]:
    yield from running()


def running() -> Iterator[Midstride]:
    # The paths of sockets must be short, and those of pytest's temporary folders are long.
    folder = Path(tempfile.mkdtemp(prefix="ms"))
    command = Midstride(folder)
    try:
        yield command
    finally:
        try:
            command.down()
        finally:
            for process in command.started:
                with process:  # closes its output: what a failed test leaves open would fail a later one
                    process.kill()
            shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def talker() -> Iterator[Midstride]:
    """The talker's system, up on the simulator. Tests leave it as they found it."""
    for midstride in running():
        done = midstride("up", str(EXAMPLES / "talker" / "talker.stride"), "--backend", "sim", "--detach")
        assert done.status == 0, done.err
        yield midstride


def nothing_lost(swaps: list[dict[str, Any]], backend: str) -> bool:
    """On a ROS 2 that does not identify the publisher of a message, the figures may be unknown (None)."""
    allowed = {0} if backend != "ros2" or publishers_are_identified() else {0, None}
    return bool(swaps) and all({swap["lost"], swap["duplicates"]} <= allowed for swap in swaps)


def alive(pid: int) -> bool:
    info = process_info(pid)
    return info is not None and info.alive
