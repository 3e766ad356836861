"""Why something falls: what forces it, and what it would cost to keep it."""

from __future__ import annotations

from midstride.model.specification import initial
from midstride.plan.alternatives import alternatives
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import encode_plan
from midstride.plan.strategies.registry import planner
from tests.plan.cases import replaced, sound, talker
from tests.plan.test_conflicts import device
from tests.plan.test_estimates import two_on_one_device


def test_what_forces_a_fall_is_the_capacity_that_both_would_need() -> None:
    plan = sound(replaced(device(), "camera", "Better", "minimal"))
    held = "resource /dev/video0: 2 held by camera, camera_2, but the capacity is 1"
    why = f"`create camera_2 (Better)` has to wait: {held}"
    assert [(each.functionality, each.forced_by) for each in plan.degradations] == [
        ("viewer.work", [why]),
        ("camera.work", [why]),
    ]


def test_nothing_forces_what_only_the_strategy_degrades() -> None:
    plan = sound(replaced(talker(), "talker", "NewTalker", "paper"))
    assert plan.degradations
    assert all(each.forced_by == [] for each in plan.degradations)
    assert alternatives(plan) == []


def test_what_cannot_be_kept_says_why() -> None:
    found = alternatives(replaced(device(), "camera", "Better", "minimal"))
    assert [(each.functionality, each.kept_at, each.disruption) for each in found] == [
        ("viewer.work", "normal", None),
        ("camera.work", "normal", None),
    ]
    assert all(each.impossible is not None and "/dev/video0 has a capacity of 1" in each.impossible for each in found)


def test_what_can_be_kept_says_what_that_would_cost() -> None:
    start, target = two_on_one_device()
    plan = planner("minimal")(change_between(initial(start), start, target))
    assert [str(ref) for ref in plan.degraded] == ["a.work"]
    (found,) = alternatives(plan)
    assert (found.functionality, found.degraded, found.impossible) == ("a.work", ["b.work"], None)
    assert found.disruption == plan.disruption, "the two components are alike"
    assert "alternatives" not in encode_plan(plan)
    assert [each["functionality"] for each in encode_plan(plan, explain=True)["alternatives"]] == ["a.work"]
