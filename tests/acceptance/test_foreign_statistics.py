"""Many swaps of nodes without Midstride's API, with the gaps beside those of the same run without a swap.

MIDSTRIDE_FOREIGN_SWAPS says how many (200). The figures are printed: `pytest -s`.
"""

from __future__ import annotations

import asyncio
import os
import random
import signal
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from tests.acceptance.foreign_support import Robot, robot, talkers
from tests.acceptance.support import ROOT, ended
from tests.backends.ros2_support import Bare, run

SWAPS = int(os.environ.get("MIDSTRIDE_FOREIGN_SWAPS", "200"))
SECONDS = 300 + 30 * SWAPS
pytestmark = [pytest.mark.ros2, pytest.mark.long, pytest.mark.timeout(SECONDS + 60)]


def quantiles(gaps: Sequence[float]) -> str:
    ordered = sorted(gaps)
    at = [ordered[min(len(ordered) - 1, int(len(ordered) * part))] for part in (0.5, 0.99)]
    return f"p50 {at[0]:.2f}, p99 {at[1]:.2f}, max {ordered[-1]:.2f} periods ({len(ordered)})"


def figures(system: Robot, period: float, what: str) -> None:
    """Print the gaps at the changes of the writer, and all others."""
    gaps = [((later - earlier) / period, old != new) for (earlier, old, _), (later, new, _) in pairwise(system.heard)]
    print(f"\n{what}: at a swap {quantiles([gap for gap, swap in gaps if swap])}", file=sys.stderr)
    print(f"{what}: without   {quantiles([gap for gap, swap in gaps if not swap])}", file=sys.stderr)


@pytest.mark.parametrize(
    ("kinds", "rate"),
    [
        (("Plain", "Plain"), 50.0),
        (("Plain", "Native"), 50.0),
        (("Native", "Ours"), 50.0),
        (("Native", "Native"), 1000.0),
    ],
    ids=["rclpy and rclpy", "rclpy and C", "C and a component", "C at 1 kHz"],
)
def test_nothing_is_missing_and_one_is_heard_at_each_moment(
    tmp_path: Path, kinds: tuple[str, str], rate: float
) -> None:
    async def scenario() -> None:
        async with robot(talkers(tmp_path, kinds[0], rate), tmp_path) as system:
            for number in range(SWAPS):
                await system.replaced(kinds[1 - number % 2])
            assert len(system.changes()) == SWAPS
            holes = system.holes()
            print(f"\nslots left to a successor that came late: {holes}", file=sys.stderr)
            # One for each swap at most, on a machine that keeps the successor from running for a period.
            assert len(holes) <= (SWAPS if rate > 100 else 0)
            assert all(int(last) + 2 == int(number) for last, number in (hole.split()[1::2] for hole in holes))
            figures(system, 1 / rate, f"{kinds[0]} and {kinds[1]} at {rate:g} Hz")

    with ended():
        run(scenario(), SECONDS)


def test_the_manager_is_killed_at_random_moments(tmp_path: Path) -> None:
    """A quarter as often. At most two slots are silent: no gap is longer than three periods, or than one without it."""
    kills, draw = max(1, SWAPS // 4), random.Random(14)
    (tmp_path / "system").mkdir()
    talkers(tmp_path, "Plain")
    heard: list[tuple[float, str, int]] = []

    async def manage(bare: Bare, component: str, seconds: float = 0.0) -> None:
        command = (sys.executable, "-m", "tests.acceptance._foreign_manager", str(tmp_path), component, str(seconds))
        process = await asyncio.create_subprocess_exec(*command, cwd=ROOT, stderr=asyncio.subprocess.PIPE)
        ending = asyncio.ensure_future(process.communicate())
        await bare.until(ending.done, 120)
        expected = 0 if component == "down" else -signal.SIGKILL
        assert process.returncode == expected, (process.returncode, ending.result()[1][-2000:])

    async def scenario() -> None:
        from std_msgs.msg import String

        with Bare("recorder") as bare:

            def hear(message: String) -> None:
                name, number = message.data.split()
                heard.append((time.monotonic(), name, int(number)))

            bare.node.create_subscription(String, "/chat", hear, 1000)
            await manage(bare, "Plain", 0.0)
            await bare.until(lambda: len(heard) > 20)
            for number in range(kills):
                await manage(bare, ("Ours", "Native", "Plain")[number % 3], draw.uniform(0.0, 2.0))
                count = len(heard)
                await bare.until(lambda count=count: len(heard) > count + 50, 30)  # type: ignore[misc]
            await manage(bare, "down")

    with ended():
        run(scenario(), SECONDS)
    begun = next(index for index, (_, _, number) in enumerate(heard) if number > 20)
    gaps = [(later - earlier) / 0.02 for (earlier, _, _), (later, _, _) in pairwise(heard[begun:])]
    changes = sum(old != new for (_, old, _), (_, new, _) in pairwise(heard))
    print(f"\nmanager killed {kills} times, {changes} changes of the writer: {quantiles(gaps)}", file=sys.stderr)
    around = [(later - earlier) / 0.02 for (earlier, old, _), (later, new, _) in pairwise(heard[begun:]) if old != new]
    assert all(gap <= 3.0 or gap <= sorted(gaps)[int(len(gaps) * 0.999)] for gap in around), around
    assert max(gaps) < 50, "silent for a second"
