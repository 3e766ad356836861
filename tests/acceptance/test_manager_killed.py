"""The manager killed with -9 at every point of a hand-over: the robot goes on, and is found again."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from midstride.runtime.handover import RESUME_PERIODS
from midstride.runtime.measure import Row
from tests.acceptance.support import PERIOD, ROOT, Recorder, ended

pytestmark = pytest.mark.ros2

# Where a death hurts most: between the two sides being told, and before the outcome is known.
CRITICAL = ("meet", "cut_out", "cut_in", "await_cut")


def manage(folder: Path, component: str, point: str = "-") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.acceptance.managing", str(folder), component, point]
    return subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, timeout=90)


def silences(rows: list[Row]) -> list[float]:
    """By the times of publication, where they are told: the recorder has a jitter of its own."""
    times = sorted(row.received if row.source is None else row.source for row in rows)
    return [(later - earlier) / 1e9 for earlier, later in itertools.pairwise(times)]


def points_of(calls: list[str], only: tuple[str, ...] | None) -> list[str]:
    """Before and after each call of a change, or of those named alone."""
    numbers = [number for number, op in enumerate(calls) if only is None or op in only]
    return [f"{number}{after}" for number in numbers for after in ("", "+")]


def killed_at_each(folder: Path, only: tuple[str, ...] | None = None, times: int = 1) -> None:
    system = folder / "system"
    system.mkdir()
    killed = 0
    with ended():
        first = manage(system, "nothing")
        assert first.returncode == 0, first.stdout + first.stderr
        whole = manage(system, "OtherSource").stdout.splitlines()
        points = points_of([line.split()[1] for line in whole if line.startswith("call ")], only) * times
        recorder = Recorder(folder)
        recorder.wait_until_it_hears()
        for number, point in enumerate(points):
            run = manage(system, ("Source", "OtherSource")[number % 2], point)
            killed += run.returncode == -signal.SIGKILL
            assert run.returncode in (0, -signal.SIGKILL), f"{point}: {run.stdout}{run.stderr}"
            # The next manager finds a valid and whole system, whatever the last one left.
            again = manage(system, "nothing")
            assert again.returncode == 0, f"after {point}: {again.stdout}{again.stderr}"
        rows = recorder.stop()
        end = manage(system, "down")
        assert end.returncode == 0, end.stdout + end.stderr
    # A change to what is there already makes fewer calls; the others all end in death.
    assert killed >= len(points) // 2
    assert max(silences(rows)) <= (RESUME_PERIODS + 2) * PERIOD


def test_the_topic_is_never_silent_for_longer_than_is_stated(tmp_path: Path) -> None:
    killed_at_each(tmp_path, CRITICAL)


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_the_topic_is_never_silent_for_longer_than_is_stated_at_any_point(tmp_path: Path) -> None:
    killed_at_each(tmp_path, times=2)
