"""Many seeds, on every processor, and what they have in common."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from midstride.simulation.run import SeedRun, simulate
from midstride.simulation.scenario import Scenario


@dataclass
class Summary:
    """``cells`` counts, by fault, kind of step and branch of recovery, how many faults led there."""

    seeds: int = 0
    failed: list[SeedRun] = field(default_factory=list)
    outcomes: Counter[str] = field(default_factory=Counter)
    struck: Counter[str] = field(default_factory=Counter)
    branches: Counter[tuple[str, str]] = field(default_factory=Counter)
    cells: Counter[tuple[str, str, str]] = field(default_factory=Counter)

    def add(self, run: SeedRun) -> None:
        self.seeds += 1
        if run.problems:
            self.failed.append(run)
        self.outcomes.update(run.outcomes)
        for each in run.struck:
            self.struck[each.fault] += 1
            for branch in each.branches:
                self.branches[each.fault, branch] += 1
                self.cells[each.fault, each.step, branch] += 1


def simulate_many(seeds: Iterable[int], scenario: Scenario | None = None, jobs: int = 1) -> Iterator[SeedRun]:
    """The runs of ``seeds`` in their order, ``jobs`` at a time, each in a process."""
    if jobs <= 1:
        yield from (simulate(seed, scenario) for seed in seeds)
        return
    # Processes that are forked have the scenario already.
    with multiprocessing.get_context("fork").Pool(jobs, _begin, (scenario,)) as pool:
        yield from pool.imap(_run, seeds, chunksize=8)


_scenario: Scenario | None = None


def _begin(scenario: Scenario | None) -> None:
    global _scenario
    _scenario = scenario


def _run(seed: int) -> SeedRun:
    return simulate(seed, _scenario)
