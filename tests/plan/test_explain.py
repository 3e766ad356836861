"""Where a plan degrades something, from which step to which: against the levels of each configuration on the way."""

from __future__ import annotations

from random import Random

import pytest

from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.disruption import Levels
from midstride.plan.explain import degradations
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan import systems

Stretch = tuple[str, int, int | None, float, int | None]


def stretches(plan: Plan) -> list[Stretch]:
    """Functionality, the first and the last step of each stretch below its baseline, its seconds, unserved since."""
    levels = Levels(plan.change)
    configurations = [plan.change.start]
    for step in plan.steps:
        configurations.append(step.action.effect(configurations[-1]))
    found: list[Stretch] = []
    roles = {plan.change.role_of(name) for each in configurations for name in each.instances}
    for counted in (each for role in sorted(roles) for each in levels.counted(role)):
        levels_of = [levels.level(each, counted.ref) for each in configurations]
        since: int | None = None
        for number, level in enumerate([*levels_of, counted.baseline]):
            below = level > counted.baseline
            if below and since is None:
                since = number
            elif not below and since is not None:
                until = number if number < len(levels_of) else None
                seconds = sum(step.seconds for step in plan.steps[max(since - 1, 0) : until])
                lost = range(max(since, 1), len(levels_of) if until is None else until)
                unserved = next((at for at in lost if levels_of[at] == counted.worst), None)
                found.append((str(counted.ref), since, until, round(seconds, 6), unserved))
                since = None
    return sorted(found, key=lambda each: (each[1], each[0]))


@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce", "stop"])
def test_every_stretch_below_the_baseline_is_listed_with_its_steps_and_seconds(strategy: str) -> None:
    kinds = set[str]()
    for seed in range(30):
        rng = Random(seed)
        ends = systems.tight(rng, 3) if seed % 2 else systems.change(rng, systems.system(rng, 5, 4), 5)
        try:
            plan = STRATEGIES[strategy](change_between(initial(ends[0]), *ends))
        except PlanRefused:
            continue
        found = [
            (each.functionality, each.since, each.until, round(each.seconds, 6), each.unserved)
            for each in degradations(plan.change, plan.steps)
        ]
        assert found == stretches(plan), f"seed {seed}"
        kinds |= {"unserved" if unserved is not None else "served" for *_, unserved in found}
    assert kinds == {"served", "unserved"}


def test_what_ends_below_its_baseline_is_listed_to_the_end() -> None:
    """The change is cut short, as by a roll-back that does not come."""
    rng = Random(1)
    ends = systems.tight(rng, 3)
    plan = STRATEGIES["stop"](change_between(initial(ends[0]), *ends))
    fallen = next(each for each in degradations(plan.change, plan.steps) if each.until is not None)
    assert fallen.until is not None
    [cut] = [
        each
        for each in degradations(plan.change, plan.steps[: fallen.until - 1])
        if each.functionality == fallen.functionality
    ]
    assert (cut.since, cut.until, cut.unserved) == (fallen.since, None, fallen.unserved)
    assert 0.0 < cut.seconds < fallen.seconds or plan.steps[fallen.until - 1].seconds == 0.0
    assert FunctionalityRef(*cut.functionality.split(".")) in {
        counted.ref for role in ends[0].nodes for counted in Levels(plan.change).counted(role)
    }
