"""The timer looks at what a step touches, and finds what a walk over the whole system finds."""

from __future__ import annotations

from typing import Any, cast

import pytest

from midstride.model.action import Action
from midstride.model.best import best
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification, structure
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import STRATEGIES, planner
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.watch.degradation_timer import DegradationTimer
from tests.plan.cases import replacing
from tests.runtime.systems import example


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def steady(self) -> float:
        return self.now


def walked(change: Change, visited: list[tuple[float, Configuration]], end: float) -> dict[str, float]:
    """The seconds below the baseline, each configuration looked at from end to end."""
    levels = Levels(change)
    roles = sorted({*change.specification.nodes} & {*change.target.nodes})
    seconds: dict[FunctionalityRef, float] = {}
    until = [*(begun for begun, _ in visited[1:]), end]
    for (begun, configuration), ended in zip(visited, until, strict=True):
        for ref in levels.fallen(configuration, roles):
            seconds[ref] = seconds.get(ref, 0.0) + ended - begun
    return {str(ref): round(spent, 6) for ref, spent in sorted(seconds.items())}


def carried_out(plan: Plan, steps: int) -> tuple[dict[str, float], dict[str, float]]:
    """So many steps of ``plan``, and then their roll-back: as the timer has it, and as the walk has it."""
    clock = Clock()
    timer = DegradationTimer(plan.change, cast(Any, clock), LifeTable(cast(Any, clock)))
    configuration = plan.change.start
    visited = [(0.0, configuration)]
    done: list[tuple[Action, Configuration]] = []

    def move(action: Action) -> None:
        nonlocal configuration
        clock.now += 1.0 + len(visited) / 7
        configuration = action.apply(configuration)
        timer.moved(configuration, action.instances())
        visited.append((clock.now, configuration))

    for step in plan.steps[:steps]:
        done.append((step.action, configuration))
        move(step.action)
    if steps < len(plan.steps):
        for action, before in reversed(done):
            for undoing in action.undo(before):
                move(undoing)
    clock.now += 2.5
    return timer.stop(), walked(plan.change, visited, clock.now)


@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
@pytest.mark.parametrize(("name", "role"), [("talker", "talker"), ("filter", "filter")])
def test_a_replacement_and_its_roll_back_at_any_step(name: str, role: str, strategy: str) -> None:
    specification = example(name)
    running = best(structure(specification))
    node = specification.nodes[role]
    others = [other for other in sorted(specification.components) if _fits(specification, role, other)]
    assert others, node
    plan = planner(strategy)(replacing(running, specification, role, others[0]))
    found = [carried_out(plan, steps) for steps in range(len(plan.steps) + 1)]
    assert all(timed == expected for timed, expected in found)
    if strategy == "paper":
        assert all(timed for timed, _ in found[-1:]), "the paper's way degrades what relies on the node"


def test_what_has_been_lowered_before_is_counted_from_the_start() -> None:
    specification = example("talker")
    running = best(structure(specification))
    lowered = running.with_modes({ref: 1 for ref in running.modes if ref.instance == "listener"})
    change = change_between(lowered, specification, specification)
    plan = planner("minimal")(change)
    timed, expected = carried_out(plan, len(plan.steps))
    assert timed == expected != {}


def _fits(specification: Specification, role: str, other: str) -> bool:
    now = specification.component_of(role)
    then = specification.components[other]
    return then.name != now.name and then.ports() == now.ports()
