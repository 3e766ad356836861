"""What each event costs the robot, by strategy: ``python3 trial.py --worlds 100 --figure trial.svg``.

Every event happens in the same seeded halls, in virtual time, with the same programs, start-up times and controllers.
The first four strategies are Midstride's. The others are a robot without it: with ``restart`` a supervisor kills what
is replaced or hangs, and starts what is missing; with ``restart+timeout`` the controller also stops where it has heard
of no obstacles for half a second; with ``nothing`` there is no supervisor. A crash is noticed at once, a hang and a bad
version after 2 s, by Midstride's user and by the supervisor.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import multiprocessing
import random
import statistics
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

sys.path.insert(0, str(Path(__file__).resolve().parent))

from fork import Fork
from lab import Lab, Managed, Supervised, robot

MANAGED = ("minimal", "paper", "quiesce", "stop")
WITHOUT = ("restart", "restart+timeout", "nothing")
# What is replaced by what, and what dies or hangs.
CHANGES = {
    "the lidar driver is replaced": (("lidar", "SmoothLidar"),),
    "the detector moves to another": (("camera_detector", "LargeDetector"),),
    "the perception is upgraded": (
        ("lidar", "SmoothLidar"),
        ("camera", "Camera"),
        ("lidar_detector", "LidarDetector"),
        ("camera_detector", "LargeDetector"),
        ("fusion", "Fusion"),
    ),
    "a bad version is deployed": (("lidar_detector", "BadDetector"),),
    "the manager dies": (("lidar", "SmoothLidar"),),
}
CRASHES = {"the lidar driver dies": "lidar", "the planner is killed": "planner"}
HANGS = {"the detector hangs": "camera_detector"}
EVENTS = (*CHANGES, *CRASHES, *HANGS)

# An event, and the strategy.
Case: TypeAlias = tuple[str, str]

PEOPLE = 6
NOTICED = 2.0  # after how long a hang, or a bad version, is noticed (s)
ABSENT = 5.0  # for how long there is no manager after it was killed (s)
AFTER = 25.0  # how long a run goes on after the event (s)


def strategies(event: str) -> tuple[str, ...]:
    if event == "the manager dies":
        return MANAGED
    return (*MANAGED, *WITHOUT[:2]) if event in CHANGES else (*MANAGED, *WITHOUT)


def run(seed: int, event: str, strategy: str, after: float = AFTER) -> dict[str, Any]:
    """One robot in hall ``seed``, to which ``event`` happens (``none``: nothing does), for ``after`` s more."""
    lab = Lab(robot(), seed, PEOPLE)

    async def main() -> dict[str, Any]:
        under = await _until_the_event(lab, seed, strategy)
        try:
            return await _from_the_event_on(under, seed, event, strategy, after)
        finally:
            await under.close()

    return lab.simulator.run(main())


def runs(seed: int, cases: Sequence[Case], after: float = AFTER) -> list[dict[str, Any]]:
    """What :func:`run` returns for each case, all of one :func:`kind`: they do not differ until the event."""
    lab = Lab(robot(), seed, PEOPLE)

    async def main() -> list[dict[str, Any]]:
        under = await _until_the_event(lab, seed, cases[0][1])
        found = []
        for event, strategy in cases:
            if (fork := Fork()).is_child:
                await fork.end(_from_the_event_on(under, seed, event, strategy, after))
            found.append(fork.result())
        await under.close()
        return found

    return lab.simulator.run(main())


def kind(strategy: str) -> str:
    """Strategies of the same kind have the same robot until the event."""
    return "managed" if strategy in MANAGED else "timeout" if strategy == "restart+timeout" else "without"


def _drawn(seed: int) -> tuple[float, float]:
    """When the event happens (s), and how long after the beginning of a change the manager dies."""
    drawn = random.Random(f"event {seed}")
    return drawn.uniform(6.0, 14.0), drawn.uniform(0.1, 3.0)


async def _until_the_event(lab: Lab, seed: int, strategy: str) -> Managed | Supervised:
    timeout = 0.5 if kind(strategy) == "timeout" else 0.0
    robot = Managed(lab, Path("simulated")) if kind(strategy) == "managed" else Supervised(lab, timeout)
    await robot.up()
    await lab.open_hall()
    await lab.watch(_drawn(seed)[0], robot.level)
    lab.seen.lost = lab.seen.blind = lab.seen.longest_blind = 0.0
    return robot


async def _from_the_event_on(
    robot: Managed | Supervised, seed: int, event: str, strategy: str, after: float
) -> dict[str, Any]:
    said: list[str] = []
    if isinstance(robot, Managed):
        robot.strategy = strategy
        act = _managed(robot, event, _drawn(seed)[1], said)
    else:
        act = _supervised(robot, event, strategy)
    acting = asyncio.ensure_future(act)
    await robot.lab.watch(after, robot.level)
    if not acting.done():
        said.append("under way at the end")
        acting.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await acting
    robot.lab.require_no_errors()
    return {"seed": seed, "event": event, "strategy": strategy, **asdict(robot.lab.seen), "said": said}


def _runs(work: tuple[int, Sequence[Case]]) -> list[dict[str, Any]]:
    return runs(*work)


async def _managed(robot: Managed, event: str, during: float, said: list[str]) -> None:
    faults = robot.lab.simulator.faults
    if event == "the manager dies":
        change = asyncio.ensure_future(robot.change(*CHANGES[event]))
        change.add_done_callback(lambda task: task.cancelled() or task.exception())  # what dies with it is no news
        await asyncio.sleep(during)
        robot.life.kill()
        change.cancel()
        await asyncio.sleep(ABSENT)
        await robot.up()
    elif event in CHANGES:
        said.append((await robot.change(*CHANGES[event])).outcome)
        if event == "a bad version is deployed" and said == ["done"]:  # it got in
            await asyncio.sleep(NOTICED)
            said.append((await robot.change(("lidar_detector", "LidarDetector"))).outcome)
    elif event in CRASHES:
        faults.kill(robot.instance(CRASHES[event]))
        await asyncio.sleep(0.01)
        said.append((await robot.restore(CRASHES[event], hangs=False)).outcome)
    elif event in HANGS:
        robot.lab.hang(robot.instance(HANGS[event]))
        await asyncio.sleep(NOTICED)
        said.append((await robot.restore(HANGS[event], hangs=True)).outcome)


async def _supervised(robot: Supervised, event: str, strategy: str) -> None:
    faults = robot.lab.simulator.faults
    for role, component in CHANGES.get(event, ()):
        await robot.restart(role, component)
    if event == "a bad version is deployed":
        await asyncio.sleep(NOTICED)
        await robot.restart("lidar_detector")
    if (role := CRASHES.get(event)) is not None:
        faults.kill(role)
    if (hangs := HANGS.get(event)) is not None:
        robot.lab.hang(hangs)
        await asyncio.sleep(NOTICED)
    if (role := role or hangs) is not None and strategy != "nothing":
        await robot.restart(role)


# -- the table ---------------------------------------------------------------------------------------------------


def share(hits: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson)."""
    z, p = 1.96, hits / of
    middle, half = p + z * z / (2 * of), z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return max(0.0, (middle - half) / (1 + z * z / of)), min(1.0, (middle + half) / (1 + z * z / of))


def mean(figures: Sequence[float]) -> tuple[float, float, float]:
    """A mean and its 95 % interval, by 1000 resamples from a fixed seed."""
    drawn = random.Random(1)
    means = sorted(statistics.fmean(drawn.choices(figures, k=len(figures))) for _ in range(1000))
    return statistics.fmean(figures), means[25], means[974]


def table(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Markdown, a line for each event and strategy; the mission lost is against the same hall without the event."""
    undisturbed = {row["seed"]: row["progress"] for row in rows if row["event"] == "none"}
    pace = statistics.fmean(undisturbed.values()) / (AFTER + 10.0) if undisturbed else 1.0
    columns = ("event", "strategy", "runs", "with a collision", "near misses", "mission lost, s")
    yield f"| {' | '.join((*columns, 'functionality-seconds lost', 'blind, s'))} |"
    yield "|---|---|---|---|---|---|---|---|"
    for event in ("none", *EVENTS):
        for strategy in (*MANAGED, *WITHOUT):
            found = [row for row in rows if (row["event"], row["strategy"]) == (event, strategy)]
            if not found:
                continue
            hit, count = sum(row["collisions"] > 0 for row in found), len(found)
            low, high = share(hit, count)
            missed = [
                (undisturbed[row["seed"]] - row["progress"]) / pace for row in found if row["seed"] in undisturbed
            ]
            cells = [f"{hit} ({low:.0%} to {high:.0%})", f"{sum(row['near_misses'] for row in found)}"]
            for figures in (missed, [row["lost"] for row in found], [row["blind"] for row in found]):
                cells.append("{:.1f} ({:.1f} to {:.1f})".format(*mean(figures)) if figures else "–")
            yield f"| {event} | `{strategy}` | {count} | {' | '.join(cells)} |"


def figure(rows: Sequence[dict[str, Any]]) -> str:
    """SVG: for each event, the share of runs with a collision by strategy, with its interval."""
    left, line, wide = 210, 13, 300
    parts, y = [], 34
    for share_ in (0.0, 0.25, 0.5, 0.75, 1.0):
        x = left + wide * share_
        parts.append(f'<text x="{x}" y="20" text-anchor="middle">{share_:.0%}</text>')
    for event in EVENTS:
        parts.append(f'<text x="4" y="{y + 10}" font-weight="bold">{event}</text>')
        for strategy in strategies(event):
            found = [row for row in rows if (row["event"], row["strategy"]) == (event, strategy)]
            y += line
            if found:
                hit = sum(row["collisions"] > 0 for row in found)
                low, high = (left + wide * bound for bound in share(hit, len(found)))
                colour = "#2a7" if strategy in MANAGED else "#c33"
                x = left + wide * hit / len(found)
                parts.append(f'<text x="{left - 10}" y="{y + 13}" text-anchor="end">{strategy}</text>')
                parts.append(f'<path d="M{low:.1f} {y + 9}H{high:.1f}" stroke="{colour}" stroke-width="2"/>')
                parts.append(f'<circle cx="{x:.1f}" cy="{y + 9}" r="4" fill="{colour}"/>')
        y += 2 * line
    grid = "".join(f"M{left + wide * part / 4} 26V{y}" for part in range(5))
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{left + wide + 30}" height="{y + 6}" font-family="sans-serif"'
    )
    ground = '<rect width="100%" height="100%" fill="#fff"/>'
    return f'{head} font-size="11">{ground}<path d="{grid}" stroke="#ddd"/>{"".join(parts)}</svg>\n'


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=100, help="how many halls")
    parser.add_argument("--first", type=int, default=1, help="the seed of the first")
    parser.add_argument("--event", help="only events whose name contains this")
    parser.add_argument(
        "--strategies", nargs="+", choices=(*MANAGED, *WITHOUT), default=(*MANAGED, *WITHOUT), help="only these"
    )
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--out", type=Path, help="append each run to this file, a line of JSON; runs in it are not repeated"
    )
    parser.add_argument("--figure", type=Path, help="also write the shares of runs with a collision as SVG")
    options = parser.parse_args()

    rows: list[dict[str, Any]] = []
    if options.out is not None and options.out.exists():
        rows = [json.loads(line) for line in options.out.read_text().splitlines()]
    done = {(row["seed"], row["event"], row["strategy"]) for row in rows}
    chosen = [event for event in EVENTS if (options.event or "") in event]
    seeds = range(options.first, options.first + options.worlds)
    every = [("none", "minimal"), *((event, each) for event in chosen for each in strategies(event))]
    wanted: dict[tuple[int, str], list[Case]] = {}
    for seed in seeds:
        for event, strategy in every:
            if strategy in options.strategies and (seed, event, strategy) not in done:
                wanted.setdefault((seed, kind(strategy)), []).append((event, strategy))
    with multiprocessing.get_context("fork").Pool(options.jobs) as pool:
        for found in pool.imap_unordered(_runs, [(seed, cases) for (seed, _), cases in wanted.items()]):
            rows += found
            if options.out is not None:
                with options.out.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in found)
    rows.sort(key=lambda row: int(row["seed"]))  # the intervals are of samples in this order
    print("\n".join(table(rows)))
    if options.figure is not None:
        options.figure.write_text(figure(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
