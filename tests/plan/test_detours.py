"""Plans with detours: nodes that stay and are moved, stand-ins; and what the proof then speaks of."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from random import Random

import pytest
from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.component import ComponentSpec, FunctionalityRef
from midstride.model.specification import Keep, Specification, initial
from midstride.plan.change import Change, Detour
from midstride.plan.change_builder import change_between
from midstride.plan.core.core_plan import Budget
from midstride.plan.core.detours import further, with_detours
from midstride.plan.estimate import Estimate
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.plan import Plan
from midstride.plan.strategies.detour_search import minimal_with_detours
from midstride.plan.strategies.minimal import minimal
from midstride.plan.strategies.registry import STRATEGIES, planner
from tests.plan import systems
from tests.plan.cases import NEED, component, functionality, sound, system, told, work
from tests.plan.exhaustive import Detoured, Exhaustive, TooLarge
from tests.plan.test_core import cheapest_rests, searches
from tests.replay.bound_check import BoundCheck
from tests.replay.plan_replay import replay


def between(start: Specification, target: Specification) -> Change:
    return change_between(initial(start), start, target)


def important(name: str, **others: object) -> ComponentSpec:
    return component(name, functionality("watch", outputs=["out"], weight=20.0), **others)  # type: ignore[arg-type]


def crowded(*more: ComponentSpec, outputs: str = "out") -> Specification:
    """A GPU with room for the old detector and a logger, but not for both detectors unless the logger is away."""
    components = [
        work("Logger", outputs=[outputs], resource_usage={"gpu": 1.0}),
        important("Old", resource_usage={"gpu": 2.0}),
        important("New", resource_usage={"gpu": 1.0}),
        *more,
    ]
    nodes = {"logger": ("Logger", {outputs: "/log"}), "detector": ("Old", {"out": "/objects"})}
    return system(components, nodes, resources={"gpu": 3.0})


def detoured(start: Specification) -> Plan:
    return minimal_with_detours(between(start, start.with_replaced("detector", "New")))


def test_a_node_that_stays_makes_room() -> None:
    start = crowded()
    direct = minimal(between(start, start.with_replaced("detector", "New")))
    plan = sound(detoured(start))
    assert (direct.disruption, plan.disruption) == (60.0, 6.0)
    assert (plan.proved_minimal, plan.lower_bound, plan.proof_space) == (True, 6.0, "detours")
    assert plan.change.detours == (Detour("logger", moved=True),)
    assert plan.remarks == (
        "Detour: logger does not change, but is replaced by logger_2: what it holds is free meanwhile.",
    )
    assert [step for step in told(plan) if step.startswith(("create", "remove"))] == [
        "remove logger",
        "create detector_2 (New)",
        "remove detector",
        "create logger_2 (Logger)",
    ]


def test_a_node_that_stays_on_a_full_topic_may_make_room_on_it() -> None:
    components = [work(name, outputs=["out"]) for name in ("A", "B", "NewB", "C")]
    nodes = {"a": ("A", {"out": "/x"}), "b": ("B", {"out": "/x"}), "c": ("C", {"out": "/y"})}
    start = system(components, nodes, caps={"/x": 2})
    change = between(start, start.with_replaced("b", "NewB"))
    assert [detour.role for detour in further(change, ()) if detour.moved and detour.stand_in is None] == ["a"]


def test_a_stand_in_serves_until_there_is_room() -> None:
    plan = sound(detoured(crowded(important("Light"))))
    assert (plan.disruption, plan.degraded, plan.proved_minimal) == (0.0, (), True)
    assert plan.change.detours == (Detour("detector", stand_in="Light"),)
    assert plan.remarks == ("Detour: detector_3 (Light) stands in for detector during the change.",)
    assert "hand over /objects from detector.out to detector_3.out" in told(plan)
    assert "hand over /objects from detector_3.out to detector_2.out" in told(plan)
    *_, end = plan.configurations()
    assert sorted(end.instances) == ["detector_2", "logger"]


def test_a_node_that_is_moved_has_a_stand_in() -> None:
    """The detector has none, so the logger makes room; its own is what keeps it up meanwhile."""
    plan = sound(detoured(crowded(work("Light", outputs=["log"]), outputs="log")))
    assert (plan.disruption, plan.degraded) == (0.0, ())
    assert plan.change.detours == (Detour("logger", moved=True, stand_in="Light"),)


def test_a_stand_in_needs_the_functionalities_and_ports_of_the_role() -> None:
    others = [
        component("OtherName", functionality("look", outputs=["out"])),
        component("OtherPort", functionality("watch", outputs=["image"])),
        important("SameBody", resource_usage={"gpu": 1.0}),
    ]
    assert detoured(crowded(*others)).change.detours == (Detour("logger", moved=True),)


def test_a_stand_in_serves_a_node_that_stays_and_lacks_its_input() -> None:
    """The map can be had without the scan that is missing while the lidar driver is replaced."""
    components = [
        *(work(name, outputs=["scan"], resource_usage={"port": 1.0}) for name in ("Old", "New")),
        component("Mapper", functionality("map", ["scan"], ["out"], weight=5.0)),
        component("Memory", functionality("map", [], ["out"], assumes=[]), needs={"scan": NEED}),
    ]
    nodes = {"lidar": ("Old", {"scan": "/scan"}), "mapper": ("Mapper", {"scan": "/scan", "out": "/map"})}
    start = system(components, nodes, resources={"port": 1.0})
    change = between(start, start.with_replaced("lidar", "New"))
    plan = sound(minimal_with_detours(change))
    assert plan.change.detours == (Detour("mapper", stand_in="Memory"),)
    assert minimal(change).disruption - plan.disruption == pytest.approx(5.0 * 1.5)


def test_where_nothing_is_lost_the_proof_covers_detours() -> None:
    start = crowded()
    start = replace(start, resources=systems.unbounded(start).resources)
    plan = detoured(start)
    assert (plan.disruption, plan.proof_space, plan.change.detours, plan.remarks) == (0.0, "detours", (), ())


def test_the_json_form_names_the_space_and_the_detours() -> None:
    plan = detoured(crowded())
    document = json.loads(json.dumps(encode_plan(plan)))
    assert (document["proof_space"], document["detours"]) == (
        "detours",
        [{"role": "logger", "moved": True, "stand_in": None}],
    )
    again = decode_plan(document)
    assert (again.change, again.steps, again.proof_space) == (plan.change, plan.steps, "detours")
    assert replay(again).bound == BoundCheck("holds")
    document["detours"][0]["role"] = "nobody"
    with pytest.raises(PlanRefused, match="a detour is about nobody, which is not there"):
        decode_plan(document)
    direct = encode_plan(minimal(between(crowded(), crowded())))
    assert direct["proof_space"] == "direct"
    assert "detours" not in direct


def test_a_bound_that_only_holds_without_detours_is_too_high_with_them() -> None:
    start = crowded()
    direct = minimal(between(start, start.with_replaced("detector", "New")))
    assert replay(direct).bound == BoundCheck("holds")
    result = replay(replace(direct, proof_space="detours"))
    assert not result.holds
    assert str(result).endswith("a plan with a disruption of 6 exists; " + detoured(start).remarks[0])
    stand_in = crowded(important("Light"))
    claimed = replace(minimal(between(stand_in, stand_in.with_replaced("detector", "New"))), proof_space="detours")
    assert "a plan with a disruption of 0 exists" in str(replay(claimed))


def test_the_replay_of_a_document_knows_how_long_what_the_plan_does_not_take_would_take() -> None:
    """The logger took 40 s to start, so to move it is no detour that helps."""
    start = crowded()
    components = {name: replace(each, startup_seconds=None) for name, each in start.components.items()}
    start = replace(start, components=start.components.update(components), timing=Map(remove=0.5))
    measured = {"create Logger": Estimate(80.0, 70.0, 90.0), "create New": Estimate.exactly(1.0)}
    change = change_between(initial(start), start, start.with_replaced("detector", "New"), measured)
    plan = sound(minimal_with_detours(change))
    assert plan.change.detours == ()
    document = encode_plan(plan)
    assert document["measured"]["create Logger"] == (80.0, 70.0, 90.0)
    assert replay(decode_plan(document)).bound == BoundCheck("holds")
    del document["measured"]
    assert not replay(decode_plan(document)).holds


def test_only_a_plan_with_detours_may_have_a_stand_in() -> None:
    plan = detoured(crowded(important("Light")))
    result = replay(replace(plan, proof_space="direct"))
    assert str(result).endswith("detector_3 differs from the declaration of detector in the target")


@pytest.mark.parametrize("strategy", sorted(set(STRATEGIES) - {"minimal"}))
def test_the_other_strategies_make_no_detours(strategy: str) -> None:
    with pytest.raises(PlanRefused, match=f"the strategy {strategy} makes no detours"):
        planner(strategy, detours=True)


def test_a_detour_meets_a_constraint_that_no_direct_plan_meets() -> None:
    start = crowded()
    keep = Keep(FunctionalityRef("detector", "watch"), "normal")
    target = replace(start.with_replaced("detector", "New"), constraints=(keep,))
    with pytest.raises(PlanRefused, match="no plan was found that meets the constraint"):
        minimal(between(start, target))
    assert sound(minimal_with_detours(between(start, target))).disruption == 6.0
    both = replace(target, constraints=(keep, Keep(FunctionalityRef("logger", "work"), "normal")))
    with pytest.raises(PlanRefused, match="no plan was found that meets the constraint"):
        minimal_with_detours(between(start, both))


def test_a_search_that_ends_early_proves_nothing() -> None:
    start = crowded(work("Light", outputs=["out"]))
    change = between(start, start.with_replaced("detector", "New"))
    plan = minimal_with_detours(change, Budget(states=0))
    assert (plan.lower_bound, plan.proved_minimal, plan.proof_space) == (0.0, False, "detours")
    assert replay(plan).holds


# -- against the slow twins ------------------------------------------------------------------------------


def small(seed: int, most: int) -> Change | None:
    """A change that disrupts something without detours, every other one tight; None for most seeds."""
    rng = Random(seed)
    if seed % 2:
        start, target = systems.change(rng, systems.system(rng, 3, 2), 3)
    else:
        start, target = systems.tight(rng, rng.randint(1, 2))
    change = between(start, target)
    try:
        return change if Exhaustive(change, most).optimum() else None
    except TooLarge:
        return None


def agree(seeds: Iterable[int], most: int) -> tuple[int, int]:
    """How many changes are planned as well as every order with every detour, and how many of them with detours."""
    compared = better = 0
    for seed in seeds:
        change = small(seed, most)
        if change is None:
            continue
        try:
            least = Detoured(change, most + 4).optimum()
        except TooLarge:
            continue
        plan = sound(minimal_with_detours(change))
        assert plan.disruption == pytest.approx(least), f"seed {seed}"
        assert plan.proved_minimal, f"seed {seed}"
        assert decode_plan(encode_plan(plan)).change == plan.change
        assert replay(plan).bound == BoundCheck("holds"), f"seed {seed}"
        compared += 1
        better += bool(plan.change.detours)
    return compared, better


def test_detours_are_as_good_as_every_order_with_every_detour() -> None:
    assert agree((4, 8, 21, 28), most=6) == (4, 1)


@pytest.mark.full
def test_detours_are_as_good_on_more_systems() -> None:
    compared, better = agree(range(200), most=6)
    assert compared > 15
    assert better > 1


@pytest.mark.long
def test_detours_are_as_good_on_many_systems() -> None:
    compared, better = agree(range(6000), most=8)
    assert compared > 500
    assert better > 80


def test_the_logic_program_finds_the_same_detours() -> None:
    pytest.importorskip("clingo")
    from tests.plan.answer_sets import AnswerSets

    for seed in (21, 28):
        change = small(seed, most=6)
        assert change is not None
        assert AnswerSets(change, detours=2).optimum() == pytest.approx(Detoured(change).optimum()), f"seed {seed}"


@pytest.mark.parametrize("seed", [4, 11, 20, 32])
def test_with_detours_every_bound_on_the_way_is_at_most_what_is_left(seed: int) -> None:
    rng = Random(seed)
    change = between(*systems.tight(rng, 2))
    for detour in further(change, ()):
        for search in searches(with_detours(change, [detour])):
            for state, least in cheapest_rests(search).items():
                assert search.bounds.of(state) <= least + 1e-9, f"{detour}, {state:b}"
