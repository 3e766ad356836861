"""What finishing a plan lowers, and what rolling it back does, beside the slow, obvious twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random

import pytest
from immutables import Map

from midstride.errors import PlanRefused
from midstride.lang import load
from midstride.model.action import Remove
from midstride.model.specification import Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.estimate import Estimate
from midstride.plan.lowering import PlanLowering
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan.slow_lowering import below, choices, is_better_finished
from tests.plan.test_random import drawn

EXAMPLES = Path(__file__).parents[2] / "examples"


def with_durations(change: Change, random: Random) -> Change:
    """With components of which some start quickly and others slowly, as earlier runs have shown."""
    names = sorted({*change.specification.components, *change.target.components})
    slow = {f"create {name}": Estimate.exactly(random.choice([0.1, 1.0, 30.0])) for name in names}
    return replace(change, measured=Map(slow))


def slow_to_return() -> Specification:
    """The filter's example, whose filter takes 20 s to start."""
    specification = load(EXAMPLES / "filter" / "filter.stride").require()
    slow = replace(specification.components["MeanFilter"], startup_seconds=20.0)
    return replace(specification, components=specification.components.set("MeanFilter", slow))


@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_every_prefix_of_drawn_plans_is_judged_as_by_the_twin(strategy: str) -> None:
    plans = 0
    for seed in range(40):
        try:
            plan = STRATEGIES[strategy](with_durations(drawn(seed), Random(seed)))
        except PlanRefused:
            continue
        lowering = PlanLowering(plan)
        plans += 1
        configuration = plan.change.start
        for done, step in enumerate(plan.steps):
            after = step.action.effect(configuration)
            finishing, rolling_back = lowering.finishing(done), lowering.rolling_back(done)
            slowly = choices(plan, done)
            assert (finishing.lasting, finishing.seconds) == pytest.approx(slowly[0], abs=1e-5), (seed, done)
            assert (rolling_back.lasting, rolling_back.seconds) == pytest.approx(slowly[1], abs=1e-5), (seed, done)
            if below(after, plan) > below(configuration, plan):
                assert lowering.lowers(done), (seed, done)
            configuration = after
    assert plans > 20


@pytest.mark.parametrize("strategy", ["paper", "quiesce", "stop"])
@pytest.mark.parametrize("restarted", ["source", "sink"])
def test_what_takes_long_to_start_again_is_better_not_rolled_back(strategy: str, restarted: str) -> None:
    """The filter that leaves would take 20 s to start again: once it is removed, the rest is better carried out."""
    specification = slow_to_return()
    request = PlanRequest(replace=(("filter", "MedianFilter"),), restart=(restarted,))
    target = request.target(specification)
    change = change_between(initial(specification), specification, target, renewed=request.renewed(target))
    plan = STRATEGIES[strategy](change)
    lowering = PlanLowering(plan)
    asked = [index for index in range(len(plan.steps)) if lowering.lowers(index)]
    better = [lowering.is_better_finished(index) for index in asked]
    assert better == [is_better_finished(plan, index) for index in asked]
    [removal] = [index for index, step in enumerate(plan.steps) if step.action == Remove("filter")]
    assert better == [index > removal for index in asked] and set(better) == {False, True}
