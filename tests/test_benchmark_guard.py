"""What a benchmark has started ends with it, however that ends."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.foreign.lab import until

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
# Starts a process in a session of its own, and says its number.
BENCHMARK = """
import subprocess, sys, time
from _guard import guard
guard()
process = subprocess.Popen(["sleep", "600"], start_new_session=True)
try:
    print(process.pid, flush=True)
    time.sleep(600)
finally:
    print("ended as usual", flush=True)
"""


def is_running(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_is_left_of_a_benchmark(how: signal.Signals) -> None:
    command = [sys.executable, "-c", BENCHMARK]
    benchmark = subprocess.Popen(command, cwd=BENCHMARKS, stdout=subprocess.PIPE, text=True)
    assert benchmark.stdout is not None
    pid = int(benchmark.stdout.readline())
    assert is_running(pid)
    benchmark.send_signal(how)
    said, _ = benchmark.communicate(timeout=30)
    assert said.strip() == ("" if how is signal.SIGKILL else "ended as usual")
    until(lambda: not is_running(pid), "it is left behind")
