"""Durations of steps with their spread, and plans that are best only with the expected ones."""

from __future__ import annotations

from dataclasses import replace

import pytest
from immutables import Map

from midstride.model.component import FunctionalityRef, FunctionalitySpec, Gate, Mode, Resource, StopTimes
from midstride.model.contract import Predicate
from midstride.model.specification import Limit, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.estimate import Estimate
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.goals_in_progress import with_time_for_goals
from midstride.plan.overlap import duration
from midstride.plan.plan import Plan
from midstride.plan.sensitivity import sensitivity
from midstride.plan.state_continuity import with_time_for_state
from midstride.plan.strategies.registry import planner
from tests.plan.cases import NEED, system, work


def two_on_one_device() -> tuple[Specification, Specification]:
    """Once one of the old ones has gone, there is room for the new other one beside its old one."""
    parts = [
        replace(work(f"{kind}{role}", outputs=["out"], resource_usage={"gpu": held}), startup_seconds=None)
        for role in "AB"
        for kind, held in (("Old", 2.0), ("New", 1.0))
    ]
    nodes = {role.lower(): (f"Old{role}", {"out": f"/{role}"}) for role in "AB"}
    start = replace(system(parts, nodes, resources={"gpu": 4.0}), timing=Map(probation=0.0))
    return start, start.with_replaced("a", "NewA").with_replaced("b", "NewB")


def planned(measured: dict[str, Estimate], strategy: str = "minimal") -> Plan:
    start, target = two_on_one_device()
    return planner(strategy)(change_between(initial(start), start, target, measured))


def test_an_estimate_is_the_median_with_the_shortest_and_the_longest() -> None:
    assert Estimate.of([0.4, 9.0, 0.6]) == Estimate(0.6, 0.4, 9.0)
    assert Estimate(0.6, 0.4, 9.0).plus(1.0) == Estimate(1.6, 1.4, 10.0)
    assert Estimate.exactly(2.0).between is None


def test_a_plan_has_the_spread_of_what_was_measured() -> None:
    plan = planned({"create NewA": Estimate(1.0, 0.8, 5.0)})
    assert [step.between for step in plan.steps if step.describe() == "create a_2 (NewA)"] == [(0.8, 5.0)]
    taken = duration(plan)
    assert taken.between == (1.56, round(taken.seconds + 4.0, 9))
    assert taken.seconds == 1.67, "0.11 s of the 0.2 s: then the process of b_2 is what is waited for"
    assert duration(planned({})).between is None
    document = encode_plan(plan)
    assert (document["duration"], document["between"]) == (taken.seconds, taken.between)
    assert decode_plan(document).steps == plan.steps
    assert "between" not in encode_plan(planned({}))


def test_a_plan_counts_the_time_until_a_process_is_killed_as_its_component_states_it() -> None:
    start, target = two_on_one_device()
    old = replace(start.components["OldA"], gate="preload", stop=StopTimes(10.0, 5.0, 1.0))
    stated = replace(start, components=start.components.set("OldA", old))
    plan = planner("minimal")(change_between(initial(stated), stated, target, {}))
    expected = {"remove a": (0.2, 16.0), "remove b": None}
    assert {step.describe(): step.between for step in plan.steps if step.action.kind == "remove"} == expected
    plain = duration(planned({}))
    taken = duration(plan)
    assert taken.seconds == plain.seconds
    assert taken.between is not None and taken.between[0] == plain.seconds
    assert taken.between[1] == pytest.approx(plain.seconds + 15.8, abs=0.2)
    # What was measured is expected, and no less than the stated time is possible.
    measured = change_between(initial(stated), stated, target, {"remove OldA": Estimate(2.0, 1.0, 3.0)})
    assert measured.estimate("remove", measured.instance("a")) == Estimate(2.0, 1.0, 16.0)


def replacement(
    strategy: str = "minimal",
    contract: Predicate = NEED,
    gate: Gate | None = "preload",
    stop: StopTimes | None = None,
    new_gate: Gate | None = "preload",
    **timing: float,
) -> Plan:
    """Of a node behind ``gate``, which states ``stop``, by one behind ``new_gate``, for which there is room."""
    parts = [replace(work(name, outputs=["out"]), startup_seconds=None, gate="preload") for name in ("Old", "New")]
    modes = (Mode("normal", (), Map(out=contract)), Mode("degraded"))
    made = Map(work=FunctionalitySpec("work", modes, (), ("out",)))
    before, after = (replace(each, functionalities=made) for each in parts)
    start = system(
        [replace(before, gate=gate, stop=stop), replace(after, gate=new_gate)],
        {"a": ("Old", {"out": "/A"})},
        topics={"/A": contract},
    )
    start = replace(start, timing=Map(probation=0.0, **timing))
    return planner(strategy)(change_between(initial(start), start, start.with_replaced("a", "New"), {}))


def removal(plan: Plan) -> tuple[float, float] | None:
    (found,) = (step.between for step in plan.steps if step.describe() == "remove a")
    return found


def test_a_plan_counts_the_time_for_which_goals_of_the_old_node_may_go_on() -> None:
    # Besides the patience: 3 times 3 s for what is cancelled and for results, 2 s to answer requests, and the signals.
    plan = with_time_for_goals(replacement(), ["a"])
    assert removal(plan) == (0.2, 60.0 + 9.0 + 2.0 + 10.0)
    taken = duration(plan)
    assert taken.between is not None and taken.between[1] == pytest.approx(taken.seconds + 80.8)
    assert duration(replacement()).between is None
    stated = replacement(stop=StopTimes(1.0, 2.0, 3.0, 20.0))
    assert removal(with_time_for_goals(stated, ["a"])) == (0.2, 20.0 + 9.0 + 3.0 + 3.0)
    # It has no goals, is of another kind than its successor, or has been removed before that is created.
    assert removal(with_time_for_goals(replacement())) is None
    assert removal(with_time_for_goals(replacement(gate="relay"), ["a"])) is None
    assert removal(with_time_for_goals(replacement("stop"), ["a"])) is None
    assert removal(with_time_for_goals(replacement(gate=None), ["a"])) is None


def test_a_plan_counts_the_time_for_which_goals_of_a_component_with_the_api_may_go_on() -> None:
    assert removal(with_time_for_goals(replacement(gate=None, new_gate=None), ["a"])) == (0.2, 81.0)
    patient = replacement(gate=None, new_gate=None, stop=replace(StopTimes(), patience=20.0))
    assert removal(patient) is None, "the patience alone says nothing of a component without goals"
    assert removal(with_time_for_goals(patient, ["a"])) == (0.2, 41.0)


def handover(plan: Plan) -> tuple[float, float] | None:
    (found,) = (step.between for step in plan.steps if step.action.kind == "handover")
    return found


def test_a_plan_counts_the_time_in_which_state_may_move() -> None:
    found = handover(with_time_for_state(replacement(), ["a"]))
    assert found == pytest.approx((0.1, 2.1))
    assert handover(with_time_for_state(replacement(gate=None, new_gate=None), ["a"])) == found
    plan = replacement(state_timeout=10.0)
    assert handover(with_time_for_state(plan, ["a"])) == pytest.approx((0.1, 10.1))
    relays = replacement(gate="relay", new_gate="relay"), replacement(gate="relay", new_gate=None)
    assert all(handover(with_time_for_state(plan, ["a"])) == found for plan in relays)
    # It keeps none, or is of another kind than its successor.
    assert handover(with_time_for_state(plan, ["b"])) is None
    assert handover(with_time_for_state(replacement(new_gate=None), ["a"])) is None
    assert handover(with_time_for_state(replacement(gate="relay"), ["a"])) is None


def test_a_declared_action_server_may_have_goals() -> None:
    plan = replacement(contract=Predicate("test_msgs/action/Fibonacci"))
    assert removal(with_time_for_goals(plan)) == (0.2, 81.0)


def test_a_plan_that_is_best_only_as_expected_says_so() -> None:
    spread = {"create NewA": Estimate(1.0, 0.8, 5.0), "create NewB": Estimate.exactly(1.5)}
    plan = planned(spread)
    assert next(step.describe() for step in plan.steps if step.action.kind == "create") == "create a_2 (NewA)"
    words = sensitivity(plan)
    assert words is not None
    assert "`create NewA` takes 1 s, as expected. It has taken 5 s" in words
    # What is stated is true: the other plan is made, and costs that.
    slow = planned(spread | {"create NewA": Estimate.exactly(5.0)})
    assert words.endswith(f"{slow.disruption:.3g}.")


def test_a_duration_with_which_no_plan_meets_the_constraints_is_no_objection() -> None:
    start, target = two_on_one_device()
    limits = tuple(Limit(FunctionalityRef(role, "work"), seconds) for role, seconds in (("a", 3.0), ("b", 0.1)))
    spread = {"create NewA": Estimate(1.0, 0.8, 5.0), "create NewB": Estimate.exactly(1.5)}
    plan = planner("minimal")(change_between(initial(start), start, replace(target, constraints=limits), spread))
    assert sensitivity(plan) is None


def test_a_plan_that_is_best_in_any_case_says_nothing() -> None:
    assert sensitivity(planned({"create NewA": Estimate(1.0, 0.8, 1.4), "create NewB": Estimate.exactly(1.5)})) is None
    assert sensitivity(planned({"attach": Estimate(0.1, 0.1, 9.0)})) is None
    assert sensitivity(planned({"create NewA": Estimate(1.0, 0.8, 5.0)}, "paper")) is None
    alone = planned({"create NewA": Estimate(1.0, 0.8, 5.0)}).change
    only_a = alone.specification.with_replaced("a", "NewA")
    room = replace(only_a, resources=Map({"gpu": Resource("gpu", 9.0)}))
    change = change_between(initial(alone.specification), alone.specification, room, alone.measured)
    assert planner("minimal")(change).disruption == 0
    assert sensitivity(planner("minimal")(change)) is None
