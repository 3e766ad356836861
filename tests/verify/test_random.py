"""Alloy and the model's own replay agree on random plans, spoilt ones too: the same step fails, or both hold.

Every other system has services and ROS actions, of which a spoilt plan attaches a second server now and then.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from midstride.errors import PlanRefused
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import STRATEGIES
from midstride.verify.checking import AlloyOptions, verify_plan
from midstride.verify.run import Alloy, find
from tests.plan import systems
from tests.replay.plan_replay import replay

pytestmark = [pytest.mark.alloy, pytest.mark.long]


@pytest.fixture(scope="module")
def alloy() -> Alloy:
    return find()


def drawn(rng: Random, services: bool = False) -> Plan:
    """A random plan: as it was made, or with a step dropped, repeated elsewhere, or exchanged with the next."""
    while True:
        try:
            start, target = systems.change(rng, systems.system(rng, 4, 4), 5)
            if services:
                start, target = systems.with_services(rng, start, target)
            plan = STRATEGIES[rng.choice(sorted(STRATEGIES))](change_between(initial(start), start, target))
        except PlanRefused:
            continue
        if len(plan.steps) > 1:
            break
    steps, index = list(plan.steps), rng.randrange(len(plan.steps) - 1)
    match rng.choice(("as it was", "dropped", "dropped", "repeated", "exchanged")):
        case "dropped":
            steps.pop(index)
        case "repeated":
            steps.insert(rng.randrange(index, len(steps) + 1), steps[index])
        case "exchanged":
            steps[index], steps[index + 1] = steps[index + 1], steps[index]
    return replace(plan, steps=tuple(steps))


def expected(plan: Plan) -> tuple[bool, int | None]:
    """Whether the plan holds, and the first step that does not; what it says it costs is not Alloy's affair."""
    configuration = plan.change.start
    for number, step in enumerate(plan.steps, start=1):
        modes_agree = all(
            configuration.mode(change.functionality).name == change.before
            for change in step.modes
            if change.functionality in configuration.modes
        )
        if step.action.check(configuration) or not modes_agree:
            return False, number
        configuration = step.action.effect(configuration)
    whole = Plan.of(plan.strategy, plan.steps, Levels(plan.change))
    return replay(whole).holds, None


@pytest.mark.parametrize("services", [False, True], ids=["topics", "services"])
@pytest.mark.parametrize("seed", range(30))
def test_alloy_and_the_replay_agree(seed: int, services: bool, alloy: Alloy) -> None:
    plan = drawn(Random(seed), services)
    verdict = verify_plan(plan, options=AlloyOptions(alloy))
    assert (verdict.holds, verdict.failed) == expected(plan), verdict.words
    assert "please report" not in verdict.words
