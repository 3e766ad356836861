"""`midstride up --stop-on-exit`: the system lives for as long as the command."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from midstride.cli import main

EXAMPLE = Path(__file__).parents[2] / "examples" / "talker" / "talker.stride"
COMMAND = [sys.executable, "-m", "midstride", "up", str(EXAMPLE), "--backend", "sim", "--stop-on-exit"]
# As a shell script runs `command &`.
BACKGROUND = ["sh", "-c", 'trap "" INT QUIT; exec "$@"', "sh", *COMMAND]
PATIENCE = 90.0


@pytest.fixture
def folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="ms"))  # sockets have short paths
    yield folder
    shutil.rmtree(folder)


def wait(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def midstride(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    command = [sys.executable, "-m", "midstride", *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False)


@pytest.mark.full
@pytest.mark.parametrize(
    ("number", "command"),
    [(signal.SIGINT, COMMAND), (signal.SIGTERM, COMMAND), (signal.SIGTERM, BACKGROUND)],
    ids=["SIGINT", "SIGTERM", "SIGTERM of a background job"],
)
def test_a_signal_stops_the_system(folder: Path, number: signal.Signals, command: list[str]) -> None:
    output = folder / "output"
    with output.open("w") as stream:
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        process = subprocess.Popen(command, env=environment, stdout=stream, stderr=subprocess.STDOUT)
    try:
        wait(lambda: "talker is up" in output.read_text())
        assert process.poll() is None and midstride(folder, "status").returncode == 0
        process.send_signal(number)
        assert process.wait(PATIENCE) == 0
        assert output.read_text().endswith("talker is down.\n")
        assert "no system is running" in midstride(folder, "status").stderr
    finally:
        process.kill()
        midstride(folder, "down")


@pytest.mark.full
def test_the_end_of_the_parent_stops_the_system(folder: Path) -> None:
    output = folder / "output"
    script = f"import subprocess, time; subprocess.Popen({COMMAND!r}); time.sleep(1000)"
    with output.open("w") as stream:
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        parent = subprocess.Popen([sys.executable, "-c", script], env=environment, stdout=stream)
    try:
        wait(lambda: "talker is up" in output.read_text())
        parent.kill()
        parent.wait()
        wait(lambda: output.read_text().endswith("talker is down.\n"))
    finally:
        parent.kill()
        midstride(folder, "down")


def test_detach_and_stop_on_exit_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["up", str(EXAMPLE), "--detach", "--stop-on-exit"]) == 2
    assert "--stop-on-exit" in capsys.readouterr().err
