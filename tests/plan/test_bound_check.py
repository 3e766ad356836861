"""The check of a plan's lower bound: what is too high is found, and what is not checked is said."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from random import Random

import pytest

from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Limit, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.plan import BoundPart, Plan
from midstride.plan.strategies.minimal import minimal
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan import systems
from tests.plan.cases import component, functionality, replaced, system, talker
from tests.plan.exhaustive import Exhaustive
from tests.replay.bound_check import WORK, BoundCheck, check_bound
from tests.replay.plan_replay import Ledger, replay


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
            resource_usage=holds[role][end],
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


def test_a_bound_that_rests_on_keep_and_order_is_checked() -> None:
    change = tight(27, constraints=True)
    plan, free = minimal(change), minimal(tight(27))
    assert plan.proved_minimal
    assert plan.lower_bound > free.disruption
    assert replay(plan).bound == BoundCheck("holds")
    raised = dataclasses.replace(plan, lower_bound=plan.lower_bound + 0.01)
    assert check(raised).outcome == "not checked"


def test_a_bound_that_rests_on_a_limit_is_checked() -> None:
    """The first to be replaced is absent, and the limit has the more important one wait for the other."""
    components = [
        component(
            f"{kind}{role}",
            functionality("work", outputs=["out"], weight=weight),
            resource_usage={"gpu": held},
            startup_seconds=1.0,
        )
        for role, weight in (("A", 1.0), ("B", 2.0))
        for kind, held in (("Old", 2.0), ("New", 1.0))
    ]
    nodes = {role.lower(): (f"Old{role}", {"out": f"/{role}"}) for role in "AB"}
    start = system(components, nodes, resources={"gpu": 4.0})
    limit = Limit(FunctionalityRef("a", "work"), 0.5)
    target = dataclasses.replace(start.with_replaced("a", "NewA").with_replaced("b", "NewB"), constraints=(limit,))
    plan = minimal(change_between(initial(start), start, target))
    free = minimal(change_between(initial(start), start, dataclasses.replace(target, constraints=())))
    assert plan.proved_minimal
    assert plan.lower_bound > free.disruption
    assert replay(plan).bound == BoundCheck("holds")
    raised = dataclasses.replace(plan, lower_bound=plan.lower_bound + 0.01)
    assert check(raised) == BoundCheck("not checked", "it is higher than what follows from the constraints here")


@pytest.mark.parametrize(
    "seeds",
    [
        (9, 14, 16, 17, 23),
        pytest.param(range(24, 60), marks=pytest.mark.full),
        pytest.param(range(60, 200), marks=pytest.mark.long),
    ],
)
def test_a_limit_never_makes_a_bound_too_high(seeds: Sequence[int]) -> None:
    """Each functionality that falls in the cheapest plan may fall for so long, or for less."""
    higher = 0
    for seed in seeds:
        change = tight(seed)
        free = minimal(change)
        if not free.degraded:
            continue
        fall = free.degradations[0]
        limit = Limit(FunctionalityRef.parse(fall.functionality), round(fall.seconds * 0.9, 3))
        target = dataclasses.replace(change.target, constraints=(limit,))
        try:
            plan = minimal(change_between(change.start, change.specification, target))
        except PlanRefused:
            continue
        assert plan.lower_bound >= free.lower_bound - 1e-6, f"seed {seed}"
        assert replay(plan).bound == BoundCheck("holds"), f"seed {seed}"
        higher += plan.lower_bound > free.lower_bound
    assert higher > len(seeds) / 20


# -- certificates ----------------------------------------------------------------------------------------


def check(plan: Plan, work: int = WORK) -> BoundCheck:
    return check_bound(plan, Ledger(plan), work)


def computers(number: int) -> Plan:
    """On each computer, two nodes are replaced that share its memory."""
    components, nodes = [], {}
    for computer in range(number):
        for node in range(2):
            name = f"{computer}{node}"
            for kind in ("Old", "New"):
                holds = {f"memory{computer}": 2.0}
                work = functionality("work", outputs=["out"], weight=1.0 + node)
                components.append(component(f"{kind}{name}", work, resource_usage=holds))
            nodes[f"n{name}"] = (f"Old{name}", {"out": f"/n{name}"})
    start = system(components, nodes, resources={f"memory{computer}": 4.0 for computer in range(number)})
    target = start
    for role in nodes:
        target = target.with_replaced(role, f"New{role[1:]}")
    return minimal(change_between(initial(start), start, target))


def test_the_certificate_lists_the_parts_of_the_bound() -> None:
    plan = computers(2)
    assert plan.certificate == tuple(BoundPart(tuple(f"n{c}{n}" for n in range(2)), 6.0) for c in range(2))
    document = encode_plan(plan)
    assert document["certificate"][0] == {"roles": ["n00", "n01"], "bound": 6.0}
    assert decode_plan(document).certificate == plan.certificate
    assert "certificate" not in encode_plan(replaced(talker(), "talker", "NewTalker", "minimal"))


def test_with_its_certificate_a_larger_bound_is_checked() -> None:
    plan = computers(2)
    assert check(plan, work=200) == BoundCheck("holds")
    alone = dataclasses.replace(plan, certificate=())
    assert check(alone, work=200) == BoundCheck("not checked", "the change is too large")


@pytest.mark.parametrize("twice", [False, True])
def test_a_certificate_is_not_believed(twice: bool) -> None:
    """Neither what it says of its parts, nor that they are different ones."""
    plan = computers(2)
    one, other = plan.certificate
    wrong = (one, one, other) if twice else (dataclasses.replace(one, bound=6.01), other)
    claimed = dataclasses.replace(plan, lower_bound=sum(part.bound for part in wrong), certificate=wrong)
    assert check(claimed).outcome == "violated"


def test_whatever_the_parts_no_bound_above_the_least_holds() -> None:
    for seed in (9, 14, 16):
        plan, rng = minimal(tight(seed)), Random(seed)
        roles = sorted({role for step in plan.steps for role in step.roles})
        rng.shuffle(roles)
        too_high = plan.disruption + 0.01
        for place in range(1, len(roles)):
            first = rng.random() * too_high
            parts = BoundPart(tuple(roles[:place]), first), BoundPart(tuple(roles[place:]), too_high - first)
            assert check(dataclasses.replace(plan, lower_bound=too_high, certificate=parts)).outcome == "violated"


def test_a_large_change_is_not_checked() -> None:
    plan = minimal(tight(14))
    assert check(plan, work=10) == BoundCheck("not checked", "the change is too large")


def test_other_instances_than_the_change_needs_are_not_checked() -> None:
    plan = minimal(tight(14))
    renewed = dataclasses.replace(plan, change=dataclasses.replace(plan.change, leaving=plan.change.leaving[1:]))
    assert check(renewed).outcome == "not checked"
