"""keep, limit and order: met where some plan meets them, refused with the smallest set in conflict where none does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pytest

from midstride.errors import PlanRefused
from midstride.model.action import Remove
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Constraint, Keep, Limit, Node, Order, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.constraints import conflict, in_force, layers
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan.cases import (
    SLOW,
    changed,
    component,
    functionality,
    removing,
    replaced,
    system,
    talker,
    told,
    work,
)
from tests.replay.plan_replay import replay

LISTEN = FunctionalityRef("listener", "listen")


def bound(specification: Specification, *constraints: Constraint) -> Specification:
    return replace(specification, constraints=constraints)


def devices(*constraints: Constraint) -> tuple[Specification, Specification]:
    """a and b each hold a device of their own that their replacements need; one user listens to both."""
    parts = [
        work(f"{kind}{name}", outputs=["out"], resource_usage={name: 1.0}) for name in "AB" for kind in ("Old", "New")
    ]
    user = component("User", functionality("a", ["a"]), functionality("b", ["b"]))
    nodes = {"a": ("OldA", {"out": "/a"}), "b": ("OldB", {"out": "/b"}), "user": ("User", {"a": "/a", "b": "/b"})}
    start = system([*parts, user], nodes, resources={"A": 1.0, "B": 1.0})
    target = start.with_replaced("a", "NewA").with_replaced("b", "NewB")
    return start, bound(target, *constraints)


def refused(start: Specification, target: Specification, strategy: str = "minimal") -> str:
    with pytest.raises(PlanRefused) as caught:
        changed(start, target, strategy)
    return str(caught.value)


def sound(plan: Plan) -> Plan:
    result = replay(plan)
    assert result.holds, str(result)
    assert str(result).startswith(f"the plan holds: {len(plan.steps)} steps replayed")
    return plan


def test_keep_is_met_by_minimal_and_refused_by_the_paper() -> None:
    start = bound(talker(), Keep(LISTEN, "normal"))
    assert sound(replaced(start, "talker", "NewTalker", "minimal")).degraded == ()
    for strategy in ("paper", "quiesce"):
        with pytest.raises(PlanRefused) as caught:
            replaced(start, "talker", "NewTalker", strategy)
        assert "`keep listener.listen at normal`" in str(caught.value)
        assert "step 1 (degrade listener.listen from normal to degraded) takes it below" in str(caught.value)


@pytest.mark.parametrize("count", [3, 6])
def test_of_many_that_may_give_way_it_is_the_one_that_is_not_kept(count: int) -> None:
    """A full topic's contract changes: one publisher must leave before the next may come; all but the last are kept."""
    names = [f"n{number}" for number in range(count)]
    start = system(
        [work("Source", outputs=["out"])], {name: ("Source", {"out": "/x"}) for name in names}, caps={"/x": count}
    )
    topic = replace(start.connectors["/x"], guarantee=SLOW)
    target = replace(start, connectors=start.connectors.set("/x", topic))
    kept = [Keep(FunctionalityRef(name, "work"), "normal") for name in names[:-1]]
    plan = sound(changed(start, bound(target, *kept), "minimal"))
    assert told(plan)[0] == f"detach {names[-1]}.out from /x"
    assert [str(ref) for ref in plan.degraded] == [f"{names[-1]}.work"]


def test_keep_at_a_worse_mode_allows_the_fall() -> None:
    sound(replaced(bound(talker(), Keep(LISTEN, "degraded")), "talker", "NewTalker", "paper"))


def test_keep_refuses_to_take_the_publisher_away() -> None:
    start = bound(talker(), Keep(LISTEN, "normal"))
    with pytest.raises(PlanRefused, match=r"`keep listener.listen at normal` \(step 1"):
        STRATEGIES["minimal"](removing(initial(start), start, "talker"))


def test_keep_does_not_forbid_to_bring_up_what_is_down() -> None:
    start = bound(talker(), Keep(LISTEN, "normal"))
    configuration = initial(start).without_instance("talker").with_modes({LISTEN: 1})
    plan = sound(STRATEGIES["minimal"](change_between(configuration, start, start)))
    assert told(plan)[-1] == "upgrade listener.listen from degraded to normal"


def test_keep_does_not_forbid_to_replace_what_is_down_already() -> None:
    """The listener stays as low as it is, since there is no talker: the plan takes it no lower."""
    start = talker().without_node("talker")
    listen = component("NewListener", functionality("listen", ["in"]))
    start = replace(start, components=start.components.set("NewListener", listen))
    target = bound(start.with_replaced("listener", "NewListener"), Keep(LISTEN, "normal"))
    plan = sound(changed(start, target, "minimal"))
    assert "create listener_2 (NewListener)" in told(plan)


def test_keep_at_a_mode_that_is_none() -> None:
    assert "listener.listen has no mode loud; it has normal, degraded" in refused(
        talker(), bound(talker().with_replaced("talker", "NewTalker"), Keep(LISTEN, "loud"))
    )


def test_limit_counts_every_step_below_the_baseline() -> None:
    plan = replaced(talker(), "talker", "NewTalker", "paper")
    (seconds,) = [fall.seconds for fall in plan.degradations if fall.functionality == str(LISTEN)]
    target = talker().with_replaced("talker", "NewTalker")
    sound(changed(talker(), bound(target, Limit(LISTEN, seconds)), "paper"))
    words = refused(talker(), bound(target, Limit(LISTEN, seconds - 0.01)), "paper")
    assert f"`limit listener.listen below baseline {seconds - 0.01:g} s`" in words
    assert f"{seconds:g} s" in words


@pytest.mark.parametrize(("first", "then"), [("a", "b"), ("b", "a")])
@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_order_puts_all_of_one_role_before_the_other(first: str, then: str, strategy: str) -> None:
    start, target = devices(Order(first, then))
    plan = sound(changed(start, target, strategy))
    structural = [step.roles[0] for step in plan.steps if step.is_structural]
    assert structural == sorted(structural, key=[first, then].index)


def test_order_may_cost() -> None:
    """Both fit beside each other, so that nothing would fall; in the order asked for, it must not even then."""
    parts = [work(f"{kind}{name}", outputs=["out"]) for name in "AB" for kind in ("Old", "New")]
    start = system(parts, {"a": ("OldA", {"out": "/a"}), "b": ("OldB", {"out": "/b"})})
    target = bound(start.with_replaced("a", "NewA").with_replaced("b", "NewB"), Order("b", "a"))
    plan = sound(changed(start, target, "minimal"))
    assert plan.disruption == 0.0
    removed = [step.action.instance for step in plan.steps if isinstance(step.action, Remove)]
    assert removed == ["b", "a"]
    free = sound(changed(start, replace(target, constraints=()), "minimal"))
    assert plan.makespan > free.makespan


def test_order_of_a_role_that_leaves_is_the_start_s() -> None:
    start, target = devices()
    start = bound(start, Order("b", "a"))
    target = target.without_node("b")
    change = change_between(initial(start), start, target)
    assert in_force(change) == (Order("b", "a"),)
    plan = sound(STRATEGIES["minimal"](change))
    roles = [step.roles[0] for step in plan.steps if step.is_structural]
    assert roles.index("a") > max(index for index, role in enumerate(roles) if role == "b")


@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_orders_in_a_circle_are_refused(strategy: str) -> None:
    words = refused(
        *devices(Order("a", "b"), Keep(FunctionalityRef("user", "a"), "degraded"), Order("b", "a")), strategy
    )
    assert "`order a before b`" in words
    assert "`order b before a`" in words
    assert "keep" not in words


@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_orders_of_both_ends_may_contradict_each_other(strategy: str) -> None:
    """Each specification is sound by itself; nothing comes, so nothing is stuck until it is asked what goes first."""
    nodes = {name: ("Source", {"out": f"/{name}"}) for name in ("a", "b", "c")}
    start = bound(system([work("Source", outputs=["out"])], nodes), Order("c", "b"), Order("b", "a"))
    target = start.without_node("b")
    for role in ("a", "c"):
        target = target.with_node(Node(role, "Source"))
    words = refused(start, bound(target, Order("a", "c")), strategy)
    for order in ("`order c before b`", "`order b before a`", "`order a before c`"):
        assert order in words


def test_the_smallest_set_in_conflict_is_named() -> None:
    """Either device must break; which breaks first is free. The keep of b alone cannot be met."""
    user = FunctionalityRef("user", "b")
    words = refused(*devices(Order("a", "b"), Limit(FunctionalityRef("user", "a"), 60.0), Keep(user, "normal")))
    assert words.startswith("no plan was found that meets the constraint `keep user.b at normal`")
    assert words.endswith("; b and b_2 do not fit at the same time: B has a capacity of 1")
    assert "order" not in words


def test_two_that_conflict_only_together_are_both_named() -> None:
    """Memory for one more: whoever is last goes in beside, if the first is through. b first, and yet never below."""
    parts = [
        work(f"{kind}{name}", outputs=["out"], resource_usage={"memory": size})
        for name, size in (("A", 2.0), ("B", 1.0))
        for kind in ("Old", "New")
    ]
    nodes = {"a": ("OldA", {"out": "/a"}), "b": ("OldB", {"out": "/b"})}
    lighter = work("NewA", outputs=["out"], resource_usage={"memory": 1.0})
    start = system([*(part for part in parts if part.name != "NewA"), lighter], nodes, resources={"memory": 3.0})
    target = start.with_replaced("a", "NewA").with_replaced("b", "NewB")
    keep, order = Keep(FunctionalityRef("b", "work"), "normal"), Order("b", "a")
    assert sound(changed(start, bound(target, keep), "minimal")).degraded == (FunctionalityRef("a", "work"),)
    sound(changed(start, bound(target, order), "minimal"))
    words = refused(start, bound(target, keep, order))
    assert "together" in words
    assert str(keep) in words
    assert str(order) in words


def test_layers() -> None:
    assert layers("cab", [Order("b", "a"), Order("x", "c")]) == [["b", "c"], ["a"]]
    assert layers("ab", [Order("a", "b"), Order("b", "a")]) is None
    assert layers("ab", [Order("a", "a")]) == [["a", "b"]]


@pytest.mark.parametrize("size", [4, 9])
def test_a_conflict_is_narrowed_down(size: int) -> None:
    every: list[Constraint] = [Limit(FunctionalityRef("r", f"f{number}"), 0.0) for number in range(size)]
    wanted = {every[1], every[3]}

    def can_meet(some: Iterable[Constraint]) -> bool:
        return not wanted <= set(some)

    assert set(conflict(every, can_meet)) == wanted
