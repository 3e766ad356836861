"""Three experiments of SUAVE, 30 missions each, in virtual time, beside the published figures: `python campaign.py`.

The seeds are fixed (:func:`missions.scenario`), so every figure of the table is the same on every machine. The last
lines are not: they say how long this machine computed in a reaction, since computing takes no virtual time.
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import statistics
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from missions import RUNS, managing, scenario, simulate

from midstride.backends.simulator.backend import Simulator
from midstride.backends.simulator.network import SimulatedWriter

# Computed from the rows that are published with SUAVE (July 2025), in the same way as those of the runs here.
PUBLISHED: Final = Path(__file__).parent / "published.csv"
COLUMNS: Final = ("time searching pipeline (s)", "distance inspected (m)", "mean reaction time (s)")
EXPERIMENTS: Final = {
    1: "thrusters fail",
    2: "the visibility changes",
    3: "thrusters fail, and the visibility changes",
}
# What ran here, by its option, in the words of the table.
HERE: Final = {
    "none": "none, here",
    "tree": "hand-written tree, here",
    "metacontrol": "Metacontrol, here",
    "midstride": "**Midstride**",
}
# The system, the experiment, and which of its runs.
Mission = tuple[str, int, int]
# The rows of each system, of each experiment.
Rows = dict[int, dict[str, list[dict[str, Any]]]]


class Computing:
    """How long it took from the diagnostics to the reaction on this machine, the simulation of all nodes included.

    ``processor`` is the time of the processor alone; ``seconds`` has besides how long this process waited for one.
    """

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.processor: list[float] = []
        self._since = self._used = 0.0

    def watch(self, simulator: Simulator) -> None:
        def on_publish(writer: SimulatedWriter) -> None:
            if writer.topic == "/diagnostics" and writer.owner.instance != "f_maintain_motion_node":
                self._since, self._used = time.perf_counter(), time.process_time()
            elif writer.topic in ("/parameter_events", "/f_maintain_motion_node/transition_event") and self._since:
                self.processor.append(time.process_time() - self._used)
                self.seconds.append(time.perf_counter() - self._since)
                self._since = 0.0

        simulator.network.on_publish = on_publish


def quartiles(values: Sequence[float]) -> list[float]:
    """The first, the median and the third, as of SUAVE's published rows."""
    return statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else [values[0]] * 3


def cell(found: Sequence[float], digits: int) -> str:
    first, median, third = (f"{value:.{digits}f}" for value in found)
    return f"{median} ({first} to {third})"


def published(experiment: int) -> dict[str, dict[str, Any]]:
    """By system: how many runs, and the quartiles of each column."""
    found = {}
    with PUBLISHED.open(encoding="utf-8", newline="") as file:
        for first, system, runs, *figures in csv.reader(file):
            if first == str(experiment):
                values = [float(figure) for figure in figures]
                columns = {name: values[3 * k : 3 * k + 3] for k, name in enumerate(COLUMNS)}
                found[system] = {"runs": runs, **columns}
    return found


def table(rows: Rows) -> str:
    """The figures of each experiment: the median, and the quartiles in parentheses."""
    lines = []
    for experiment, systems in rows.items():
        lines += [f"Experiment {experiment}: {EXPERIMENTS[experiment]}", ""]
        lines += ["| | runs | time searching (s) | inspected (m) | mean reaction (s) |", "|---|---|---|---|---|"]
        figures = published(experiment)
        for system, missions in systems.items():
            here = {name: quartiles([float(row[name]) for row in missions]) for name in COLUMNS}
            figures[HERE[system]] = {"runs": len(missions), **here}
        for name, found in figures.items():
            cells = [cell(found[column], digits) for column, digits in zip(COLUMNS, (0, 1, 3), strict=True)]
            lines.append(f"| {name} | {found['runs']} | {' | '.join(cells)} |")
        if "midstride" in systems:
            count = sum(row["reactions"] for row in systems["midstride"])
            longest = max(row["longest reaction (s)"] for row in systems["midstride"])
            lines += ["", f"Midstride: {count} reactions, the longest took {longest:.4f} s."]
        lines.append("")
    return "\n".join(lines)


def fly(mission: Mission, metacontrol: Path | None = None) -> tuple[dict[str, Any], Computing]:
    """The row of one mission, with which one it is; and how long this machine computed in its reactions."""
    system, experiment, number = mission
    computing = Computing()
    watch = computing.watch if system == "midstride" else lambda simulator: None
    row = simulate(scenario(experiment, number), managing(system, experiment, number, metacontrol), watch)
    return {"system": system, "experiment": experiment, "number": number, **row}, computing


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--runs", type=int, default=RUNS, help="missions of each experiment (30)")
    parser.add_argument("--experiments", type=int, nargs="+", choices=EXPERIMENTS, default=list(EXPERIMENTS))
    parser.add_argument(
        "--systems", nargs="+", choices=HERE, default=["none", "tree", "midstride"], help="what runs here"
    )
    parser.add_argument("--metacontrol", type=Path, help="the folder of Metacontrol's reasoner and ontologies")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--out",
        type=Path,
        help="append each mission to this file, a line of JSON; those in it are not flown again",
    )
    options = parser.parse_args(arguments)
    wanted = [
        (system, experiment, number)
        for number in range(options.runs)
        for experiment in options.experiments
        for system in options.systems
    ]
    found: dict[Mission, dict[str, Any]] = {}
    if options.out is not None and options.out.exists():
        for row in map(json.loads, options.out.read_text(encoding="utf-8").splitlines()):
            found[row["system"], row["experiment"], row["number"]] = row
    left = [mission for mission in wanted if mission not in found]
    processor: list[float] = []
    seconds: list[float] = []
    with multiprocessing.get_context("fork").Pool(options.jobs) as pool:
        for row, computing in pool.imap(partial(fly, metacontrol=options.metacontrol), left):
            found[row["system"], row["experiment"], row["number"]] = row
            processor += computing.processor
            seconds += computing.seconds
            if options.out is not None:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
            print(f"\r{len(found)} of {len(wanted)} missions ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    rows: Rows = {experiment: {system: [] for system in options.systems} for experiment in options.experiments}
    for mission in wanted:
        rows[mission[1]][mission[0]].append(found[mission])
    print(table(rows))
    for words, times in (("processor time", processor), ("with waiting for it", seconds)):
        if times:
            median, longest = statistics.median(times) * 1e3, max(times) * 1e3
            print(f"Computing in a reaction, {words}: {median:.1f} ms (median), {longest:.1f} ms (longest).")


if __name__ == "__main__":
    main(sys.argv[1:])
