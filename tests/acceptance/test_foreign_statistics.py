"""Many swaps of nodes without Midstride's API, with the gaps beside those of the same run without a swap.

MIDSTRIDE_FOREIGN_SWAPS says how many (200). The figures are printed: `pytest -s`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from tests.acceptance.foreign_support import Robot, robot, talkers
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

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
            assert system.holes() == []
            figures(system, 1 / rate, f"{kinds[0]} and {kinds[1]} at {rate:g} Hz")

    with ended():
        run(scenario(), SECONDS)
