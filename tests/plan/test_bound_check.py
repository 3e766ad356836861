"""The check of a plan's lower bound: what is too high is found, and what is not checked is said."""

from __future__ import annotations

import dataclasses
from random import Random

import pytest

from midstride.model.specification import initial
from midstride.plan.bound_check import BoundCheck, check_bound
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.forms import decode_plan, encode_plan
from midstride.plan.minimal import minimal
from midstride.plan.plan import Plan
from midstride.plan.registry import STRATEGIES
from midstride.plan.validate import replay
from tests.plan import systems
from tests.plan.cases import component, functionality, replaced, system, talker
from tests.plan.exhaustive import Exhaustive


def tight(seed: int, constraints: bool = False) -> Change:
    rng = Random(seed)
    start, target = systems.tight(rng, 3)
    if constraints:
        target = systems.constrained(rng, start, target)
    return change_between(initial(start), start, target)


def claiming(plan: Plan, bound: float) -> Plan:
    return dataclasses.replace(plan, lower_bound=bound, proved_minimal=bound == plan.disruption)


@pytest.mark.parametrize("strategy", sorted(set(STRATEGIES) - {"minimal"}))
def test_a_plan_that_is_not_minimal_cannot_claim_to_be(strategy: str) -> None:
    plan = replaced(talker(), "talker", "NewTalker", strategy)
    result = replay(decode_plan(encode_plan(claiming(plan, plan.disruption))))
    assert not result.holds
    assert f"its lower bound, {plan.disruption:g}, is too high: a plan with a disruption of 0 exists" in str(result)


@pytest.mark.parametrize("seed", [9, 14, 16, 17, 23])
def test_the_least_disruption_is_the_highest_bound_that_holds(seed: int) -> None:
    """It is what the exhaustive search finds, which searches every order of every action."""
    change = tight(seed)
    least, plan = Exhaustive(change, most=14).optimum(), STRATEGIES["paper"](change)
    assert least is not None
    assert 0.0 < least < plan.disruption
    for bound in (0.0, least / 2, least):
        result = replay(claiming(plan, bound))
        assert (result.outcome, result.bound) == ("holds", BoundCheck("holds"))
    assert f"is too high: a plan with a disruption of {least:g} exists" in str(replay(claiming(plan, least + 0.01)))
    assert replay(minimal(change)).bound == BoundCheck("holds")


def test_caps_make_a_bound_higher() -> None:
    """Memory and GPU let a go first, c second and b last, but a_2 takes the topic of b: one of them waits for c."""
    holds = {"a": ({"gpu": 2.0}, {"gpu": 1.0}), "b": ({"memory": 1.0}, {"memory": 2.0})}
    holds["c"] = ({"gpu": 1.0, "memory": 2.0}, {"gpu": 2.0, "memory": 1.0})
    components = [
        component(
            f"{role}{end}",
            functionality("work", outputs=["out"], weight=2.0 if role == "c" else 1.0),
            holds=holds[role][end],
        )
        for role in holds
        for end in (0, 1)
    ]
    start, target = (
        system(
            components,
            {role: (f"{role}{end}", {"out": topic}) for role, topic in zip("abc", topics, strict=True)},
            caps=caps,
            resources={"gpu": 3.0, "memory": 3.0},
        )
        for caps in ({"/y": 1},)
        for end, topics in ((0, ("/x", "/y", "/c")), (1, ("/y", "/z", "/c")))
    )
    plan = minimal(change_between(initial(start), start, target))
    assert plan.disruption == pytest.approx(15.0)
    assert replay(plan).bound == BoundCheck("holds")


def test_a_bound_that_rests_on_constraints_is_not_checked() -> None:
    plan = minimal(tight(27, constraints=True))
    assert plan.proved_minimal
    result = replay(plan)
    assert result.holds
    assert result.bound.outcome == "not checked"
    assert str(result).endswith("its lower bound was not checked: it is higher than without the constraints")


def test_a_large_change_is_not_checked() -> None:
    plan = minimal(tight(14))
    assert check_bound(plan, lambda _: 0.0, work=10) == BoundCheck("not checked", "the change is too large")


def test_other_instances_than_the_change_needs_are_not_checked() -> None:
    plan = minimal(tight(14))
    renewed = dataclasses.replace(plan, change=dataclasses.replace(plan.change, leaving=plan.change.leaving[1:]))
    assert check_bound(renewed, lambda _: 0.0).outcome == "not checked"
