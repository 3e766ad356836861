"""Many swaps of nodes without Midstride's API, with the gaps beside those of the same run without a swap.

MIDSTRIDE_FOREIGN_SWAPS says how many (200), and MIDSTRIDE_FOREIGN_KILLS how often the manager is killed (50), at
moments drawn from MIDSTRIDE_FOREIGN_SEED (14). The figures are printed: `pytest -s`.
"""

from __future__ import annotations

import asyncio
import os
import random
import signal
import statistics
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest

from tests.acceptance.foreign_support import Robot, holes, robot, talkers
from tests.acceptance.support import ROOT, ended
from tests.backends.ros2_support import Bare, run

SWAPS = int(os.environ.get("MIDSTRIDE_FOREIGN_SWAPS", "200"))
KILLS = int(os.environ.get("MIDSTRIDE_FOREIGN_KILLS", "50"))
SEED = int(os.environ.get("MIDSTRIDE_FOREIGN_SEED", "14"))
SECONDS = 300 + 30 * max(SWAPS, KILLS)
PERIOD = 0.02
# When the manager is killed, in turn. What can go wrong is in the short time of the cut.
FATAL = ("cut", "handover", "cut", "swap")
# For how long after it was killed a gap may be its doing (s).
AFTER = 1.0
pytestmark = [pytest.mark.ros2, pytest.mark.long, pytest.mark.timeout(SECONDS + 60)]


def quantiles(values: Sequence[float], unit: str = "periods") -> str:
    ordered = sorted(values)
    at = [ordered[min(len(ordered) - 1, int(len(ordered) * part))] for part in (0.5, 0.99)]
    return f"p50 {at[0]:.2f}, p99 {at[1]:.2f}, max {ordered[-1]:.2f} {unit} ({len(ordered)})"


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
        seconds: list[dict[str, float]] = []
        async with robot(talkers(tmp_path, kinds[0], rate), tmp_path, in_c=True) as system:
            for number in range(SWAPS):
                seconds.append(await system.replaced(kinds[1 - number % 2], messages=5))
            assert len(system.changes()) == SWAPS
            assert system.holes() == []
            figures(system, 1 / rate, f"{kinds[0]} and {kinds[1]} at {rate:g} Hz")
            for kind in seconds[0]:
                took = quantiles([each[kind] for each in seconds], "s")
                print(f"what a swap took, {kind}: {took}", file=sys.stderr)

    with ended():
        run(scenario(), SECONDS)


@dataclass
class Managed:
    """What a separate process with a manager has printed: when each phase has begun and ended, as far as it came."""

    begun: dict[str, float] = field(default_factory=dict)
    ended: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, output: str) -> Managed:
        made = cls()
        for at, what, phase in (line.split() for line in output.splitlines()):
            (made.begun if what == "begins" else made.ended)[phase] = float(at)
        return made

    def seconds(self, phase: str) -> float:
        return self.ended[phase] - self.begun[phase]

    def during(self) -> str:
        """The innermost phase that had begun and not ended."""
        return next((p for p in ("cut", "handover", "swap") if p in self.begun and p not in self.ended), "afterwards")


def test_the_manager_is_killed_at_random_moments(tmp_path: Path) -> None:
    """At most two slots are silent.

    A moment is drawn within a phase of the swap, as long as that took in the same swap before, from its beginning.
    """
    draw = random.Random(SEED)
    (tmp_path / "system").mkdir()
    talkers(tmp_path, "Plain")
    heard: list[tuple[float, str, int]] = []
    kinds = ("Ours", "Native", "Plain")

    async def manage(bare: Bare, component: str, *fatal: str) -> tuple[Managed, float]:
        """What it has printed, and when it had ended."""
        command = (sys.executable, "-m", "tests.acceptance._foreign_manager", str(tmp_path), component, *fatal)
        process = await asyncio.create_subprocess_exec(
            *command, cwd=ROOT, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        ending = asyncio.ensure_future(process.communicate())
        await bare.until(ending.done, 120)
        at, (output, errors) = time.monotonic(), ending.result()
        expected = -signal.SIGKILL if fatal else 0
        assert process.returncode == expected, (process.returncode, output, errors[-2000:])
        return Managed.of(output.decode()), at

    async def hears(bare: Bare, messages: int) -> None:
        count = len(heard)
        await bare.until(lambda: len(heard) >= count + messages, 30)

    killed: list[tuple[str, float]] = []  # during which phase, and when

    async def scenario() -> None:
        from std_msgs.msg import String

        with Bare("recorder") as bare:

            def hear(message: String) -> None:
                name, number = message.data.split()
                heard.append((time.monotonic(), name, int(number)))

            bare.node.create_subscription(String, "/chat", hear, 1000)
            took = {kind: (await manage(bare, kind))[0] for kind in kinds}
            await hears(bare, 20)
            for number in range(KILLS):
                kind, phase = kinds[number % len(kinds)], FATAL[number % len(FATAL)]
                delay = draw.uniform(0.0, took[kind].seconds(phase))
                found, at = await manage(bare, kind, phase, str(delay))
                killed.append((found.during(), at))
                await hears(bare, int(AFTER / PERIOD))
            await manage(bare, "down")

    with ended():
        run(scenario(), SECONDS)
    rows = heard[50:]
    gaps = [(later, (later - earlier) / PERIOD, old != new) for (earlier, old, _), (later, new, _) in pairwise(rows)]
    around = [[gap for at, gap, _ in gaps if -0.1 < at - moment < AFTER] for _, moment in killed]
    calm = sorted(gap for at, gap, _ in gaps if not any(-0.1 < at - moment < AFTER for _, moment in killed))
    jitter = calm[int(len(calm) * 0.999)] - statistics.median(calm)
    counted = Counter(phase for phase, _ in killed)
    met = sum(counted[phase] for phase in ("cut", "handover"))
    print(f"\nthe manager was killed {KILLS} times, {met} of them in a hand-over: {dict(counted)}", file=sys.stderr)
    print(f"the writer changed {sum(swap for *_, swap in gaps)} times", file=sys.stderr)
    print(f"longest gap around each kill: {quantiles([max(found) for found in around])}", file=sys.stderr)
    print(f"gaps elsewhere: {quantiles(calm)}; jitter (99.9 %) {jitter:.2f} periods", file=sys.stderr)
    missing = [(two[1][0], hole) for two in pairwise(rows) for hole in holes(two)]
    for at, hole in missing:
        number, (during, moment) = min(enumerate(killed), key=lambda kill: abs(kill[1][1] - at))
        print(f"missing: {hole}, {at - moment:.3f} s after kill {number} in {during}", file=sys.stderr)
    assert met > KILLS / 2
    assert all(hole.missing <= 2 for _, hole in missing)
    assert max(map(max, around)) <= 3.0 + jitter
    assert max(gap for _, gap, _ in gaps) < 50, "silent for a second"
