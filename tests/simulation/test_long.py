"""Many seeds, the matrix of what they reached, and faults in our own code that are found.

The number of seeds is MIDSTRIDE_SIMULATION_LONG. The tables are printed, and written to the folder
MIDSTRIDE_SIMULATION_TABLES where that is set.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from midstride.simulation.campaign import Summary, simulate_many
from midstride.simulation.faults import KINDS, OF_LINKS
from tests.simulation.planted import PLANTED, SYSTEMS, planted

pytestmark = [pytest.mark.long, pytest.mark.timeout(0)]

SEEDS = int(os.environ.get("MIDSTRIDE_SIMULATION_LONG", "20000"))
# Within how many seeds a planted fault must be found.
WITHIN = 2000
STEPS = ("create", "remove", "attach", "detach", "degrade", "upgrade", "handover", "set")
BRANCHES = ("done", "refused", "rolled_back", "failed", "manager killed", "recovered")


def show(name: str, lines: Iterable[str], capsys: pytest.CaptureFixture[str]) -> None:
    text = "\n".join(lines) + "\n"
    with capsys.disabled():
        print(f"\n{text}")
    if folder := os.environ.get("MIDSTRIDE_SIMULATION_TABLES"):
        Path(folder, f"{name}.md").write_text(text, encoding="utf-8")


def matrix(summary: Summary) -> list[str]:
    """Fault by kind of step: how many strikes ended in each of ``BRANCHES``, and ``-`` where none struck."""
    lines = [f"| fault | {' | '.join(STEPS)} |", f"|---|{'---|' * len(STEPS)}"]
    for fault in (*KINDS, *OF_LINKS):
        cells = []
        for step in STEPS:
            counts = [summary.cells[fault, step, branch] for branch in BRANCHES]
            cells.append("/".join(map(str, counts)) if any(counts) else "-")
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return [f"Ends of the changes in which a fault struck: {', '.join(BRANCHES)}.", "", *lines]


def test_no_seed_violates_an_invariant_and_every_cell_of_the_matrix_is_reached(
    capsys: pytest.CaptureFixture[str],
) -> None:
    summary, begun = Summary(), time.perf_counter()
    jobs = len(os.sched_getaffinity(0))
    for run in simulate_many(range(SEEDS), jobs=jobs):
        summary.add(run)
    seconds = time.perf_counter() - begun
    rate = f"{SEEDS} seeds in {seconds:.0f} s, {SEEDS / seconds / jobs:.1f} a second and core"
    failed = [f"midstride simulate --seed {run.seed}: {'; '.join(run.problems)}" for run in summary.failed]
    show("matrix", [*matrix(summary), "", rate, *failed], capsys)
    assert not failed
    empty = [
        (fault, step)
        for fault in KINDS
        for step in STEPS
        if not any(summary.cells[fault, step, branch] for branch in BRANCHES)
    ]
    assert not empty or SEEDS < 20000
    assert not any(summary.cells[fault, step, "refused"] for fault in KINDS for step in STEPS), "it had begun"


@pytest.mark.parametrize("name", ["spread", "leased"])
def test_no_seed_on_several_hosts_violates_an_invariant(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    summary, begun, seeds = Summary(), time.perf_counter(), SEEDS // 4
    for run in simulate_many(range(seeds), jobs=len(os.sched_getaffinity(0)), name=name):
        summary.add(run)
    failed = [f"midstride simulate --system {name} --seed {run.seed}: {run.problems[0]}" for run in summary.failed]
    rate = f"{seeds} seeds on several hosts in {time.perf_counter() - begun:.0f} s"
    show(f"hosts_{name}", [*matrix(summary), "", rate, *failed], capsys)
    assert not failed


def test_planted_faults_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    lines, missed = ["| fault in our code | found by seed | violated |", "|---|---|---|"], set[str]()
    for name in PLANTED:
        with planted(name) as words:
            found = next((run for run in simulate_many(range(WITHIN), name=SYSTEMS.get(name)) if run.problems), None)
        if found is None or not any(words in problem for problem in found.problems):
            missed.add(name)
        lines.append(f"| {name} | - | |" if found is None else f"| {name} | {found.seed} | {found.problems[0]} |")
    show("planted", lines, capsys)
    assert not missed
