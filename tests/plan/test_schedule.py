"""Which steps wait for which: the reasons, one by one. `test_random` runs whole plans in every order they allow."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from midstride.model.specification import Specification
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.schedule import makespan
from midstride.plan.step import Step
from tests.plan.cases import changed, replaced, sound, system, talker, told, work


def waits_for(plan: Plan, step: str) -> list[str]:
    """The steps that ``step`` waits for, directly."""
    steps = told(plan)
    return [steps[index] for index in plan.dependencies[steps.index(step)]]


def exchange(*, cap: int | None, users: bool = True) -> tuple[Specification, Specification]:
    """On /x, publisher b comes and publisher a goes."""
    parts = [work(name, outputs=["out"]) for name in ("A", "B")] + [work("User", ["in"])]
    caps = {} if cap is None else {"/x": cap}
    others = {"user": ("User", {"in": "/x"})} if users else {}
    start = system(parts, {"a": ("A", {"out": "/x"}), **others}, caps=caps)
    return start, system(parts, {"b": ("B", {"out": "/x"}), **others}, caps=caps)


def test_a_publisher_waits_for_its_slot_on_a_capped_topic() -> None:
    plan = sound(changed(*exchange(cap=1, users=False), "paper"))
    assert "detach a.out from /x" in waits_for(plan, "attach b.out to /x")
    free = sound(changed(*exchange(cap=None, users=False), "paper"))
    assert "detach a.out from /x" not in waits_for(free, "attach b.out to /x")


def test_a_hand_over_waits_until_the_new_publisher_is_in_its_mode() -> None:
    """Between two roles; within one, the steps that determine its level keep their order anyway."""
    plan = sound(changed(*exchange(cap=1), "minimal"))
    assert "upgrade b.work from degraded to normal" in waits_for(plan, "hand over /x from a.out to b.out")


def test_support_is_withdrawn_only_once_other_support_is_there() -> None:
    plan = sound(changed(*exchange(cap=None), "minimal"))
    assert "attach b.out to /x" in waits_for(plan, "detach a.out from /x")


def test_the_makespan_is_computed_once_for_a_plan_without_conflict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1,000 replacements at once it is a fifth of the time."""
    computed = []

    def counted(steps: Sequence[Step], levels: Levels) -> float:
        computed.append(len(steps))
        return makespan(steps, levels)

    for module in ("strategies.minimal", "plan"):
        monkeypatch.setattr(f"midstride.plan.{module}.makespan", counted)
    plan = replaced(talker(), "talker", "NewTalker", "minimal")
    assert computed == [len(plan.steps)]
    assert plan.makespan == makespan(plan.steps, Levels(plan.change))
