"""The conflict core: what is tied, what its parts cost at least, and what a search that ends early may claim."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from benchmarks._conflict_core_systems import FUNCTIONALITIES, TIED, instance
from midstride.errors import PlanRefused
from midstride.model.action import Handover
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Keep, Limit, Order, Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.core.conflict_core import parts
from midstride.plan.core.core_losses import PartLosses, fullest
from midstride.plan.core.core_plan import Budget, plans_along, search_core
from midstride.plan.core.core_search import PartResult, PartSearch
from midstride.plan.core.search_state import SearchState
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.strategies.minimal import minimal
from midstride.plan.strategies.plan_builder import PlanBuilder
from tests.plan import systems
from tests.plan.cases import changed, system, work
from tests.plan.exhaustive import Exhaustive, Limited
from tests.replay.plan_replay import replay


def between(ends: tuple[Specification, Specification]) -> Change:
    start, target = ends
    return change_between(initial(start), start, target)


def searches(change: Change) -> list[PartSearch]:
    levels, full = Levels(change), fullest(change)
    return [PartSearch(part, PartLosses(change, part, levels, full), {}) for part in parts(change, ())]


@pytest.mark.parametrize("seed", [0, 40, 99])
def test_the_published_set_is_what_it_says(seed: int) -> None:
    change = between(instance(seed))
    assert sum(len(part.ops) for part in parts(change, ())) == TIED
    assert len(change.start.modes) == FUNCTIONALITIES


@pytest.mark.full
def test_a_published_change_is_proved() -> None:
    plan = minimal(between(instance(40)))
    assert (plan.proved_minimal, plan.disruption, plan.lower_bound) == (True, 1262.25, 1262.25)
    assert replay(plan).holds


def test_nothing_is_tied_where_everything_fits() -> None:
    start, target = instance(40)
    change = between((systems.unbounded(start), systems.unbounded(target)))
    assert parts(change, ()) == []
    assert search_core(Levels(change), (), Budget()).lower_bound == 0.0


def test_roles_on_different_computers_are_independent() -> None:
    change = between(instance(40))
    held = [
        {r for op in part.ops for r in change.component_of(op.instance).resource_usage} for part in parts(change, ())
    ]
    assert len(held) == 6
    assert all(not one & other for index, one in enumerate(held) for other in held[:index])


@pytest.mark.parametrize("seed", range(0, 40, 2))
def test_every_bound_on_the_way_is_at_most_what_is_left(seed: int) -> None:
    """In each state of each part, against the exact cost of the rest, by the search without a bound."""
    change = between(systems.tight(Random(seed), 3))
    for search in searches(change):
        rest = cheapest_rests(search)
        for state, least in rest.items():
            assert search.bounds.of(state) <= least + 1e-9, f"{state:b}"


def cheapest_rests(search: PartSearch) -> dict[int, float]:
    """From each state that can be reached to the end."""
    goal = search.part.everything & ~sum(1 << b for b, op in enumerate(search.part.ops) if op.kind == "detach")
    found: dict[int, float] = {}

    def rest(state: int) -> float:
        if state not in found:
            following = [cost + rest(after) for after, cost in search.moves(state)]
            found[state] = 0.0 if state & goal == goal else min(following, default=float("inf"))
        return found[state]

    rest(0)
    return found


@pytest.mark.parametrize("ended_by", [None, KeyboardInterrupt])
def test_a_search_that_ends_early_claims_no_more_than_it_knows(ended_by: type[BaseException] | None) -> None:
    def stop() -> bool:
        if ended_by is not None:
            raise ended_by
        return True

    loose = 0
    for seed in range(0, 30, 2):
        for search in searches(between(systems.tight(Random(seed), 3))):
            known = search.beam()
            ended, exact = search.run(stop, known), search.run(lambda: False, PartResult(0.0))
            assert ended.lower_bound <= exact.cost + 1e-9 <= ended.cost + 2e-9
            assert ended.moves == known.moves
            loose += ended.lower_bound < exact.cost - 1e-6
    assert loose > 0


def test_without_a_proof_the_gap_is_stated() -> None:
    change = between(systems.tight(Random(16), 3))
    plan, least = minimal(change, Budget(states=0)), minimal(change)
    assert least.proved_minimal
    assert plan.lower_bound < least.disruption <= plan.disruption
    assert not plan.proved_minimal
    assert replay(plan).holds


@pytest.mark.parametrize(("bound", "claimed"), [(9.0, (False, 9.0)), (10.0, (True, 10.0)), (11.0, (False, 0.0))])
def test_a_bound_above_the_cost_proves_nothing(bound: float, claimed: tuple[bool, float]) -> None:
    change = between(systems.tight(Random(14), 3))
    plan = minimal(change)
    assert plan.disruption == 10.0
    again = Plan.of("minimal", plan.steps, Levels(change), bound)
    assert (again.proved_minimal, again.lower_bound) == claimed


def test_outputs_are_exchanged_jointly_where_none_may_be_missing() -> None:
    """Two that stay exchange their exclusive topics, and neither may be unattached at any time."""
    components = [work(name, outputs=["out"]) for name in ("A", "B")]
    caps = {"/x": 1, "/y": 1}
    start = system(components, {"a": ("A", {"out": "/x"}), "b": ("B", {"out": "/y"})}, caps=caps)
    target = system(components, {"a": ("A", {"out": "/y"}), "b": ("B", {"out": "/x"})}, caps=caps)
    keeps = tuple(Keep(FunctionalityRef(role, "work"), "normal") for role in ("a", "b"))
    plan = minimal(between((start, replace(target, constraints=keeps))))
    assert plan.degraded == ()
    assert replay(plan).holds


def test_an_output_takes_over_the_exclusive_topic_of_another_node_without_a_gap() -> None:
    """Both nodes stay; the one that reads the topic may not degrade."""
    components = [work("A", outputs=["out"]), work("B", outputs=["out"]), work("User", inputs=["in"])]
    user = ("User", {"in": "/x"})
    caps = {"/x": 1}
    start = system(components, {"a": ("A", {"out": "/x"}), "b": ("B", {}), "user": user}, caps=caps)
    target = system(components, {"a": ("A", {}), "b": ("B", {"out": "/x"}), "user": user}, caps=caps)
    keep = Keep(FunctionalityRef("user", "work"), "normal")
    levels = Levels(between((start, replace(target, constraints=(keep,)))))
    core = search_core(levels, (keep,), Budget())
    assert core.moves is not None and [[op.kind for op in move] for move in core.moves] == [["attach", "detach"]]
    state = SearchState.at_start(PlanBuilder.at_start(levels), [])
    plans = [[type(step.action).__name__ for step in plan.steps] for plan in plans_along(state, core.moves)]
    assert plans and all("Handover" in plan and "Detach" not in plan for plan in plans)


def test_two_outputs_take_over_from_two_others_on_a_topic_that_is_full() -> None:
    names = ("a", "b", "c", "d")
    components = [*(work(name.upper(), outputs=["out"]) for name in names), work("User", inputs=["in"])]

    def writing(*writers: str) -> Specification:
        nodes = {name: (name.upper(), {"out": "/x"} if name in writers else {}) for name in names}
        return system(components, {**nodes, "user": ("User", {"in": "/x"})}, caps={"/x": 2})

    keep = Keep(FunctionalityRef("user", "work"), "normal")
    levels = Levels(between((writing("a", "b"), replace(writing("c", "d"), constraints=(keep,)))))
    core = search_core(levels, (keep,), Budget())
    assert core.moves is not None
    assert [sorted(op.kind for op in move) for move in core.moves] == [["attach", "attach", "detach", "detach"]]
    state = SearchState.at_start(PlanBuilder.at_start(levels), [])
    for plan in plans_along(state, core.moves):
        swaps = [swap for step in plan.steps if isinstance(step.action, Handover) for swap in step.action.swaps]
        assert {swap.old.instance for swap in swaps} == {"a", "b"} and {swap.new.instance for swap in swaps} == {
            "c",
            "d",
        }
        break
    else:
        pytest.fail("there is no plan along the core")


def test_where_an_order_waits_for_an_output_to_leave_its_topic_that_is_a_step_of_the_search() -> None:
    """Nothing else brings it: the node stays, and no other output takes its place."""
    components = [work(name, outputs=["out"]) for name in ("A", "B", "NewB")]
    start = system(components, {"a": ("A", {"out": ("/x", "/y")}), "b": ("B", {"out": "/z"})})
    target = system(components, {"a": ("A", {"out": "/x"}), "b": ("NewB", {"out": "/z"})})
    change = between((start, replace(target, constraints=(Order("a", "b"),))))
    core = search_core(Levels(change), change.target.constraints, Budget())
    assert core.moves is not None and core.moves[0][0].kind == "detach" and core.lower_bound == 0.0
    plan = minimal(change)
    assert plan.proved_minimal
    first = [action for step in plan.steps if (action := step.action).instances() == ("a",)]
    assert first and plan.steps[0].action == first[0]


# -- what cannot be met ------------------------------------------------------------------------------------


def two_resources(*constraints: Keep | Limit | Order) -> tuple[Specification, Specification]:
    """a's replacement does not fit beside it on the GPU; b's does not in memory."""
    components = [
        work(f"{kind}{name}", outputs=["out"], resource_usage={resource: 1.0})
        for name, resource in (("A", "gpu"), ("B", "memory"))
        for kind in ("Old", "New")
    ]
    nodes = {"a": ("OldA", {"out": "/a"}), "b": ("OldB", {"out": "/b"})}
    start = system(components, nodes, resources={"gpu": 1.0, "memory": 1.0})
    target = start.with_replaced("a", "NewA").with_replaced("b", "NewB")
    return start, replace(target, constraints=constraints)


def test_only_the_resource_in_conflict_is_named() -> None:
    keep, order = Keep(FunctionalityRef("a", "work"), "normal"), Order("a", "b")
    with pytest.raises(PlanRefused) as caught:
        changed(*two_resources(order, keep), "minimal")
    assert str(caught.value).endswith("; a and a_2 do not fit at the same time: gpu has a capacity of 1")
    assert "memory" not in str(caught.value)
    assert "order" not in str(caught.value)


def test_a_cap_in_conflict_is_named() -> None:
    """The new one comes silent, so it cannot take over by a hand-over, and both at once are one too many."""
    components = [work("Old", outputs=["out"]), work("New", ["in"], ["out"]), work("Feed", outputs=["out"])]
    start = system(components, {"n": ("Old", {"out": "/x"})}, caps={"/x": 1})
    target = start.with_replaced("n", "New")
    user = Limit(FunctionalityRef("n", "work"), 0.0)
    with pytest.raises(PlanRefused) as caught:
        changed(start, replace(target, constraints=(user,)), "minimal")
    assert str(caught.value).endswith("; n_2.out and n.out do not fit at the same time: /x has a cap of 1")


def test_the_bound_counts_the_seconds_of_limits() -> None:
    """It is what the exhaustive search finds that counts them too, and above what is least without the limits."""
    higher = impossible = 0
    for seed in (0, 1, 2, 3, 6, 9, 47):
        rng = Random(seed)
        start, target = systems.tight(rng, 2)
        refs = rng.sample([FunctionalityRef(role, "f") for role in sorted(start.nodes)], 2)
        limits = tuple(Limit(ref, rng.choice((0.8, 1.0, 1.5, 2.5))) for ref in refs)
        change = between((start, replace(target, constraints=limits)))
        least, bound = Limited(change).optimum(), search_core(Levels(change), limits, Budget()).lower_bound
        assert bound <= (float("inf") if least is None else least) + 1e-9
        if least is None:
            impossible += 1
        else:
            assert bound == pytest.approx(least)
            higher += least > (Exhaustive(change).optimum() or 0.0)
    assert min(higher, impossible) > 0


def test_limit_of_no_time_is_proved_like_a_keep() -> None:
    """A limit of 0 s forbids the states below the baseline, and the bound knows."""
    rng = Random(607)
    start, target = systems.change(rng, systems.system(rng, 4, 3), 5)
    asked = systems.constrained(rng, start, target).constraints
    never = tuple(each for each in asked if isinstance(each, Limit) and not each.seconds)
    assert never
    change = between((start, replace(target, constraints=never)))
    plan = minimal(change)
    assert plan.proved_minimal
    assert plan.disruption > (Exhaustive(change).optimum() or 0.0)
