"""The processes of a benchmark end with it, however that ends; each one that starts processes sees to that."""

from __future__ import annotations

import ast
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


# Makes a network namespace, with a process that has no mark, and a folder.
BENCHMARK_WITH_A_HOST = """
import os, pathlib, subprocess, tempfile, time
from _guard import guard, remove_at_end
guard()
folder = pathlib.Path(tempfile.mkdtemp())
remove_at_end(folder)
name = f"midstride-{os.getpid()}-host"
subprocess.run(["ip", "netns", "add", name], check=True)
sleep = ["nsenter", f"--net=/run/netns/{name}", "env", "-i", "sleep", "600"]
process = subprocess.Popen(sleep, start_new_session=True)
print(process.pid, name, folder, flush=True)
time.sleep(600)
"""


@pytest.mark.hosts
def test_its_namespaces_and_folders_go_with_a_benchmark_that_is_killed() -> None:
    command = [sys.executable, "-c", BENCHMARK_WITH_A_HOST]
    benchmark = subprocess.Popen(command, cwd=BENCHMARKS, stdout=subprocess.PIPE, text=True)
    assert benchmark.stdout is not None
    pid, name, folder = benchmark.stdout.readline().split()
    assert is_running(int(pid)) and Path("/run/netns", name).exists() and Path(folder).exists()
    benchmark.kill()
    benchmark.communicate(timeout=30)
    until(lambda: not Path(folder).exists(), "the folder is left behind")
    assert not is_running(int(pid)) and not Path("/run/netns", name).exists()


# A benchmark that imports one of them starts processes.
STARTERS = {"subprocess", "multiprocessing", "playwright.sync_api", "midstride.runtime.manager"}
# Its manager is that of the simulator.
SIMULATED = {"steps"}


def imported(program: str) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("path", sorted(BENCHMARKS.glob("[a-z]*.py")), ids=lambda path: path.stem)
def test_a_benchmark_that_starts_processes_ends_them(path: Path) -> None:
    program = path.read_text(encoding="utf-8")
    starts = path.stem not in SIMULATED and not STARTERS.isdisjoint(imported(program))
    assert not starts or "    guard()\n" in program


@pytest.mark.parametrize("folder", sorted(path.parent for path in BENCHMARKS.glob("*/__main__.py")))
def test_a_benchmark_of_several_files_does_so_too(folder: Path) -> None:
    starts = any(not STARTERS.isdisjoint(imported(path.read_text(encoding="utf-8"))) for path in folder.glob("*.py"))
    program = (folder / "__main__.py").read_text(encoding="utf-8")
    assert not starts or "    guard()\n" in program
