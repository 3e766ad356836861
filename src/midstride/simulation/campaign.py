"""Many seeds, on every processor, and what they have in common."""

from __future__ import annotations

import multiprocessing
import random
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import groupby
from typing import Final

from midstride.simulation.scenario import Scenario, built_in
from midstride.simulation.seed_run import SeedRun, Simulation
from midstride.simulation.system import System

# How many seeds in succession change one system: the first of them brings it up.
SHARED_BY: Final = 20
# Of so many built-in systems in succession, the last has services and ROS actions, the one before a container, and the
# one before that is on several hosts.
SERVING: Final = 5


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


class Runs:
    """Runs seeds, of the built-in scenario or another. Seeds of the built-in one change the system of those before.

    ``name``: of the built-in system that each seed changes; None: one after the other.
    """

    def __init__(self, scenario: Scenario | None = None, name: str | None = None) -> None:
        self._scenario = scenario
        self._name = name
        self._system: System | None = None
        self._next = -1

    def run(self, seed: int) -> SeedRun:
        """Run ``seed``, after those that change the same system before it, unless they have just been run."""
        if seed != self._next or _first(seed, self._scenario) == seed:
            self.close()
            for earlier in range(_first(seed, self._scenario), seed):
                self._run(earlier)
        return self._run(seed)

    def _run(self, seed: int) -> SeedRun:
        drawn = random.Random(seed)
        current = None if self._system is None else self._system.specification
        scenario = self._scenario or built_in(drawn, current, self._name or _system_of(seed))
        if self._system is None:
            self._system = System(scenario.specification, scenario.specifications(), _first(seed, self._scenario))
        run = Simulation(seed, self._system, scenario, drawn).run()
        self._next = seed + 1
        if run.problems:  # what they have left says nothing about the next seed
            self.close()
        return run

    def close(self) -> None:
        if self._system is not None:
            self._system.close()
            self._system = None


def _system_of(seed: int) -> str:
    """The built-in system that ``seed`` changes."""
    number = seed // SHARED_BY % SERVING
    return {SERVING - 1: "docking", SERVING - 2: "composed", SERVING - 3: "spread"}.get(number, "rover")


def _first(seed: int, scenario: Scenario | None) -> int:
    """The first of the seeds that change the same system."""
    return seed - seed % SHARED_BY if scenario is None else seed


def simulate(seed: int, scenario: Scenario | None = None) -> SeedRun:
    """Run one seed, of the built-in scenario or another."""
    return next(simulate_many((seed,), scenario))


def simulate_many(
    seeds: Iterable[int], scenario: Scenario | None = None, jobs: int = 1, name: str | None = None
) -> Iterator[SeedRun]:
    """The runs of ``seeds`` in their order, ``jobs`` at a time, each in a process.

    Without a ``scenario``, of the built-in system ``name``, or of all.
    """
    if jobs <= 1:
        yield from _run_all(seeds, scenario, name)
        return
    groups = (list(group) for _, group in groupby(seeds, lambda seed: seed // SHARED_BY))
    # Processes that are forked have the scenario already.
    with multiprocessing.get_context("fork").Pool(jobs, _begin, (scenario, name)) as pool:
        for runs in pool.imap(_run_group, groups):
            yield from runs


def _run_all(seeds: Iterable[int], scenario: Scenario | None, name: str | None) -> Iterator[SeedRun]:
    runs = Runs(scenario, name)
    try:
        for seed in seeds:
            yield runs.run(seed)
    finally:
        runs.close()


_scenario: Scenario | None = None
_name: str | None = None


def _begin(scenario: Scenario | None, name: str | None) -> None:
    global _scenario, _name
    _scenario, _name = scenario, name


def _run_group(seeds: list[int]) -> list[SeedRun]:
    return list(_run_all(seeds, _scenario, _name))
