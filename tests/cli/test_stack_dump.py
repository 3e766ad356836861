"""A manager that hangs prints its stacks on SIGUSR1, and one that does not goes on afterwards."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from midstride.runtime.workspace import Workspace
from tests.cli.conftest import EXAMPLES, Midstride

PATIENCE = 30.0
HANGS = """
import asyncio, time
from midstride.cli.stack_dump import dump_stacks_on_signal

def hang():
    print("hangs", flush=True)
    time.sleep(60)

async def main():
    dump_stacks_on_signal(asyncio.get_running_loop())
    hang()

asyncio.run(main())
"""


def wait_for(words: str, log: Path) -> str:
    deadline = time.monotonic() + PATIENCE
    while words not in (text := log.read_text(encoding="utf-8")):
        assert time.monotonic() < deadline, text
        time.sleep(0.02)
    return text


def test_a_blocked_loop_does_not_prevent_the_stacks_of_the_threads(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with log.open("w") as output:
        process = subprocess.Popen([sys.executable, "-c", HANGS], stdout=subprocess.PIPE, stderr=output)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == b"hangs\n"
        process.send_signal(signal.SIGUSR1)
        assert " in hang\n" in wait_for(" in main\n", log)
        assert process.poll() is None
    finally:
        process.kill()
        process.communicate()


def test_a_manager_prints_its_threads_and_tasks_and_goes_on(midstride: Midstride) -> None:
    talker = str(EXAMPLES / "talker" / "talker.stride")
    assert midstride("up", talker, "--backend", "sim", "--detach").status == 0
    log = Workspace(midstride.runtime / "midstride" / "talker").manager_log
    number = midstride.manager("talker")
    os.kill(number, signal.SIGUSR1)
    assert " (most recent call first):\n" in wait_for(" asyncio tasks:\n", log)
    wait_for(" in _accept\n", log)
    assert midstride("status").status == 0
    assert midstride.manager("talker") == number
    assert midstride("down").status == 0
