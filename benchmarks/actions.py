"""What replacing the server of a ROS action costs its client, which has four goals of 2 s in progress, on real ROS 2.

Nodes without Midstride's API behind `gate preload`, in plain rclpy and in C on rcl, and components with the API,
replaced by Midstride; beside them a server that is killed and another one started, whose client gives a goal up after
6 s; and one that stays. Each fourth goal is cancelled after 0.3 s. Client and servers count, in the same way for each.
A goal is *lost* where its client gets no result, and *wrong* where that is another one than of a goal that has
succeeded, or that was to be cancelled.

The results of each block of replacements are kept as soon as it is done, and the next run goes on with the rest; remove
the file to begin anew. Interrupted or terminated, it ends what it has started.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from benchmarks.services import REST, Figures, Way, end, looked, quantiles, run, started  # noqa: E402
from midstride.lang.load import load  # noqa: E402
from tests.acceptance.acting import Goals, asking, written, written_with_api  # noqa: E402
from tests.acceptance.foreign_support import robot  # noqa: E402

# How many numbers a goal asks for at least, at 20 Hz.
ORDER = 40
# After how long the client of a server that was killed gives a goal up (s).
PATIENCE = 6.0
COLUMNS = ("swaps", "goals", "lost", "twice", "wrong")


def figures(goals: Goals, swaps: int) -> Figures:
    """Of one block; times in s."""
    ended = goals.ended
    return {
        "swaps": swaps,
        "goals": len(ended),
        "lost": len(goals.lost),
        "twice": len(goals.executed_twice),
        "wrong": len(goals.wrong),
        "accepted": [each.accepted for each in ended if each.status],
        "late": [each.took - each.order / 20 for each in ended if each.status and each.length == each.order],
        "load": os.getloadavg()[0],
    }


async def replaced(
    folder: Path, swaps: int, kinds: tuple[str, str], write: Callable[[Path], Path] = written
) -> tuple[Figures, list[str]]:
    """Midstride replaces the server; with the reasons of what was rolled back."""
    rolled_back: list[str] = []
    async with robot(load(write(folder)).require(), folder) as system:
        done = 0
        if system.manager.configuration.component("talker").name != kinds[1]:
            await system.replaced(kinds[1])
        async with asking(folder, system.until, ORDER) as goals:
            while done < swaps:
                outcome = await system.change(kinds[done % 2])
                done += outcome.outcome == "done"
                if outcome.outcome != "done":
                    rolled_back.append(str(outcome.because))
                await asyncio.sleep(REST)
        return figures(goals, swaps), rolled_back


async def killed(folder: Path, swaps: int) -> tuple[Figures, list[str]]:
    """Each server is killed and another one started."""
    written(folder)
    server = started(folder, "server_0")

    def executes(name: str) -> bool:
        path = folder / "executed"
        return path.exists() and f" {name}\n" in path.read_text()

    try:
        async with asking(folder, looked, ORDER, patience=PATIENCE) as goals:
            for number in range(1, swaps + 1):
                end(server)
                server = started(folder, f"server_{number}")
                await looked(partial(executes, f"server_{number}"))
                await asyncio.sleep(ORDER / 20)
    finally:
        end(server)
    return figures(goals, swaps), []


async def steady(folder: Path, swaps: int) -> tuple[Figures, list[str]]:
    """One server for as long as the replacements of one block take."""
    written(folder)
    server = started(folder, "server")
    try:
        async with asking(folder, looked, ORDER) as goals:
            await asyncio.sleep(7.0 * swaps)
    finally:
        end(server)
    return figures(goals, 0), []


WAYS: Mapping[str, Way] = {
    "replaced, rclpy": lambda folder, swaps: replaced(folder, swaps, ("Other", "Plain")),
    "replaced, C": lambda folder, swaps: replaced(folder, swaps, ("Compiled", "Native")),
    "replaced, API": lambda folder, swaps: replaced(folder, swaps, ("OwnOther", "Own"), written_with_api),
    "killed": killed,
    "none": steady,
}


def show(blocks: Sequence[Figures]) -> None:
    print(f"{'':16}" + "".join(f"{name:>10}" for name in COLUMNS), end="")
    print(f"{'accepted: median, 99 %, longest, ms':>38}{'ended later than asked for':>28}{'load':>12}")
    for way in WAYS:
        if own := [block for block in blocks if block["way"] == way]:
            sums = "".join(f"{sum(block[name] for block in own):>10}" for name in COLUMNS)
            loads = [block["load"] for block in own]
            times = "".join(quantiles([each for block in own for each in block[key]]) for key in ("accepted", "late"))
            print(f"{way:16}{sums}           {times}  {min(loads):.1f} to {max(loads):.1f}")
            for because in (each for block in own for each in block["rolled back"]):
                print(f"{'':16}one was rolled back: {because}")


if __name__ == "__main__":
    sys.exit(run(__doc__, WAYS, 100, "actions.jsonl", COLUMNS, show))
