"""Compares ways to replace a ROS node that publishes. One command measures what is not measured yet, and reports.

Each way under each condition is one file of raw rows below `--out`: a run that is stopped goes on where it was, and
`--minutes` ends it in time. `--report` measures nothing.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if not __package__:  # `python benchmarks/swap`: this folder is no place to import from
    sys.path[0] = str(ROOT)

from benchmarks._guard import guard  # noqa: E402
from benchmarks.swap import cells, hosts, report  # noqa: E402
from benchmarks.swap.all_ways import WAYS  # noqa: E402
from benchmarks.swap.machine import described  # noqa: E402
from benchmarks.swap.measure import Measured, measure  # noqa: E402
from benchmarks.swap.streams import Host, SwapFailed  # noqa: E402
from benchmarks.swap.ways import Setting, Way  # noqa: E402


def options() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python benchmarks/swap", description=__doc__)
    parser.add_argument("--ways", nargs="+", choices=[way.name for way in WAYS], metavar="WAY", help="these alone")
    parser.add_argument("--rates", nargs="+", type=float, default=list(cells.RATES), metavar="HZ")
    parser.add_argument("--sizes", nargs="+", type=int, default=list(cells.SIZES), metavar="CHARACTERS")
    parser.add_argument("--loads", nargs="+", choices=cells.LOADS, default=list(cells.LOADS))
    parser.add_argument("--every", action="store_true", help="all combinations, not one difference from the base")
    parser.add_argument("--swaps", type=int, default=20, help="of each way under each condition (20)")
    parser.add_argument("--minutes", type=float, help="skip what would end later than that")
    parser.add_argument("--seed", type=int, default=1, help="of the order of the ways (1)")
    parser.add_argument("--dora", type=Path, metavar="FOLDER", help="a virtual environment with Dora; made if absent")
    parser.add_argument("--ros1", action="store_true", help="on ROS 1 instead of ROS 2")
    parser.add_argument("--out", type=Path, help="the folder of the raw rows (benchmarks/results/swap)")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="write the plots there as well")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the tables into this page")
    parser.add_argument("--list", action="store_true", help="say what would be measured, and how long it takes")
    parser.add_argument("--report", action="store_true", help="report what has been measured")
    return parser


def usable(ways: list[Way], setting: Setting) -> list[Way]:
    """The ways that can be measured here; of each other one it is said why not."""
    found = []
    for way in ways:
        because = f"it is not there on {setting.host.backend}"
        missing = way.missing(setting) if setting.host.backend in way.backends else because
        if missing is None:
            found.append(way)
        else:
            print(f"skipped: {way.name}: {missing}", flush=True)
    return found


def run(asked: argparse.Namespace, host: Host, out: Path) -> int:
    """Measure what is not measured yet; how many cells have failed."""
    conditions = cells.conditions(asked.rates, asked.sizes, asked.loads, asked.every)
    setting = Setting(host, conditions[0].stream, out, out / "rows.jsonl", asked.dora)
    ways = {way.name: way for way in usable([way for way in WAYS if way.name in (asked.ways or [way.name])], setting)}
    wanted = cells.in_order(conditions, list(ways.values()), asked.seed)
    left = [cell for cell in wanted if not (out / cell.file).exists()]
    took = {cell: cells.seconds(cell, ways[cell.way], asked.swaps) for cell in left}
    minutes = math.ceil(sum(took.values()) / 60)
    print(f"{len(wanted)} cells, {len(left)} of them to measure, about {minutes} minutes", flush=True)
    if asked.list:
        for cell in left:
            print(f"{cell.condition}: {cell.way}")
        return 0
    about = {"machine": described(host.backend), "seed": asked.seed, "swaps": asked.swaps}
    begun, failed, not_begun = time.monotonic(), 0, 0
    for number, cell in enumerate(left, 1):
        spent = time.monotonic() - begun
        if asked.minutes is not None and spent + took[cell] > 60 * asked.minutes:
            not_begun += 1
            continue
        because = ways[cell.way].missing(Setting(host, cell.condition.stream, out, out / "rows.jsonl", asked.dora))
        if because is not None:
            print(f"skipped: {cell.condition}: {cell.way}: {because}", flush=True)
            continue
        print(f"[{number}/{len(left)}, {spent / 60:.0f} min] {cell.condition}: {cell.way}", flush=True)
        try:
            found = measure(cell, ways[cell.way], host, asked.swaps, asked.dora)
        except SwapFailed as because:
            failed += 1
            print(f"failed: {cell.condition}: {cell.way}: {because}", flush=True)
            continue
        Measured(cell, {**about, **found.about}, found.windows, found.rows).write(out / cell.file)
    if not_begun:
        print(f"{not_begun} cells were not begun, as the time would not suffice: the same command measures them")
    return failed


def main() -> int:
    """Measure and report. The exit status is 1 if something has failed."""
    asked = options().parse_args()
    out = asked.out or ROOT / "benchmarks" / "results" / ("swap_ros1" if asked.ros1 else "swap")
    out.mkdir(parents=True, exist_ok=True)
    failed = 0
    if not asked.report:
        guard()
        with hosts.ros1() if asked.ros1 else hosts.ros2() as host:
            if host is None:
                print("ROS 1 cannot be had here (tools/ros1 says why): nothing is measured")
                return 0
            failed = run(asked, host, out)
    if not asked.list:
        report.write(out, WAYS, asked.pictures, asked.page)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
