"""The manager killed with -9 at every point of a hand-over, and at every durable write: the robot goes on, and is found
again."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from midstride.runtime.handover.agreed_cut import RESUME_PERIODS
from midstride.wire.replies import Receipt
from tests.acceptance.managing import FINISH
from tests.acceptance.support import ATTEMPTS, PERIOD, ROOT, Recorder, components_looked_at, ended

pytestmark = pytest.mark.ros2

# How often the manager is killed at a durable write, each in turn.
WRITES = int(os.environ.get("MIDSTRIDE_TEST_KILLED_WRITES", "200"))
# Where a death does most harm: after one side has its orders, and before the outcome is known.
CRITICAL = {"meet", "cut_out", "cut_in", "await_cut"}


def manage(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.acceptance.managing", str(folder), *words]
    return subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=90
    )


def kill_the_manager(system: Path, *point: str, **environment: str) -> str:
    """Have a manager killed at ``point`` of a swap; what it has printed.

    On a busy machine, a change may be given up before it comes to that point: it has been rolled back, and is made
    again by another manager.
    """
    for _ in range(ATTEMPTS):
        killed = manage(system, "swap", *point, **environment)
        if killed.returncode == -signal.SIGKILL:
            return killed.stdout
        if "rolled_back" not in killed.stdout:
            break
    raise AssertionError(f"{point}: {killed.stdout}{killed.stderr}")


def calls_of_a_swap(system: Path) -> Counter[str]:
    """How often a whole change makes each call."""
    done = manage(system, "swap")
    assert done.returncode == 0 and "done None" in done.stdout, done.stdout + done.stderr
    return Counter(line.split()[1] for line in done.stdout.splitlines() if line.startswith("call "))


def silent_since(rows: list[Receipt]) -> list[tuple[float, float]]:
    """How long each silence lasted (s), and since when (s since the epoch).

    By the times of publication, where they are known: the recorder has a jitter of its own.
    """
    times = sorted(row.received if row.source is None else row.source for row in rows)
    return [((later - earlier) / 1e9, earlier / 1e9) for earlier, later in itertools.pairwise(times)]


def killed_at_each(folder: Path, only: set[str] | None = None, times: int = 1) -> None:
    system = folder / "system"
    system.mkdir()
    with ended() as token:
        # A hand-over whose moment has passed is tried again: the calls that every change makes are those of both.
        calls = calls_of_a_swap(system) & calls_of_a_swap(system)
        points = [
            (op, str(number + 1), when)
            for op, count in calls.items()
            if (op in only if only is not None else op != "write")
            for number in range(count)
            for when in ("before", "after")
        ]
        assert {op for op, _, _ in points} >= (only or CRITICAL)
        recorder = Recorder(folder)
        recorder.wait_until_it_hears()
        with components_looked_at(token) as starved:
            for point in points * times:
                # Each manager first finds a valid and whole system, whatever the last one left, and then changes it.
                kill_the_manager(system, *point)
            calls_of_a_swap(system)
        rows = recorder.stop()
        end = manage(system, "down")
        assert end.returncode == 0, end.stdout + end.stderr
    found = silent_since(rows)
    assert len(found) > 50 * len(points)
    longest = (RESUME_PERIODS + 2) * PERIOD
    for silent, since in found:
        # A process that gets no processor publishes nothing meanwhile, and is late by that.
        waited = starved.between(since, since + silent) if silent > longest else 0.0
        assert silent <= longest + waited, f"silent for {silent:.3f} s, waited for a processor for {waited:.3f} s"


@pytest.mark.long
def test_the_topic_is_never_silent_for_longer_than_is_stated(tmp_path: Path) -> None:
    killed_at_each(tmp_path, CRITICAL)


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_the_topic_is_never_silent_for_longer_than_is_stated_at_any_point(tmp_path: Path) -> None:
    killed_at_each(tmp_path, times=2)


def killed_at_writes(folder: Path, times: int, longest: float) -> None:
    """Kill the manager ``times`` times, at writes all over a change; what the next one finds is whole each time.

    Every other manager finishes what was interrupted, the others roll it back. ``longest``: how long the topic may be
    silent (s).
    """
    system = folder / "system"
    system.mkdir()
    with ended():
        writes = min(calls_of_a_swap(system)["write"] for _ in range(2))
        assert writes > 10
        points = [(str(number + 1), when) for number in range(writes) for when in ("before", "after")]
        recorder = Recorder(folder)
        recorder.wait_until_it_hears()
        begun: list[tuple[float, str]] = []
        for index in range(times):
            number, when = points[index * (len(points) // times | 1) % len(points)]
            policy = {FINISH: "1"} if (index + index // len(points)) % 2 else {}
            begun.append((time.time(), f"killed {when} write {number}{', to be finished' if policy else ''}"))
            assert_found_whole(kill_the_manager(system, "write", number, when, **policy))
        assert_found_whole(manage(system, "swap").stdout)
        rows = recorder.stop()
        end = manage(system, "down")
        assert end.returncode == 0, end.stdout + end.stderr
    silent, since = max(silent_since(rows))
    during = [f"{since - at:.3f} s before: {words}" for at, words in begun if at <= since + silent]
    assert silent <= longest, f"silent for {silent:.3f} s; {'; '.join(during[-3:])}"


def assert_found_whole(printed: str) -> None:
    """What the killed manager left was brought to one end of the change: nothing is missing, and nothing left over."""
    [line] = [line for line in printed.splitlines() if line.startswith("found ")]
    left = json.loads(line.removeprefix("found "))
    assert left["roles"] == ["sink", "source"] and left["orphans"] == [], left
    assert left["source"] == left["declared"] and None not in left["outcomes"], left


@pytest.mark.full
def test_whatever_write_the_manager_is_killed_at_the_next_one_finds_a_whole_system(tmp_path: Path) -> None:
    killed_at_writes(tmp_path, 4, longest=2.0)


@pytest.mark.long
@pytest.mark.timeout(60 + 20 * WRITES)
def test_the_manager_may_be_killed_at_each_write_in_turn(tmp_path: Path) -> None:
    killed_at_writes(tmp_path, WRITES, longest=1.0)  # no cut is interrupted: the machine may hold up a publisher
