"""Every plan of every strategy, on random systems and random changes, replayed and compared with slow twins.

A planner that is in the registry is covered by being there.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from midstride.errors import PlanRefused
from midstride.model.action import Handover
from midstride.model.rules import violations
from midstride.model.specification import Constraint, Limit, Order, Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between, change_of_roles
from midstride.plan.constraints import in_force
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import STRATEGIES
from tests.drawn import examples
from tests.plan import systems
from tests.plan.exhaustive import Constrained, Exhaustive, TooLarge
from tests.replay.plan_replay import replay
from tests.strategies.systems import specifications

SEEDS = st.integers(0, 2**32 - 1)
NAMES = st.sampled_from(sorted(STRATEGIES))
# Whether there are services and ROS actions in place of some or all of the topics.
SERVICES = st.booleans()


def drawn(
    seed: int, *, nodes: int = 5, topics: int = 4, edits: int = 5, constraints: bool = False, services: bool = False
) -> Change:
    """The change that a seed stands for. What both ends do not meet is no example."""
    rng = Random(seed)
    start, target = systems.change(rng, systems.system(rng, nodes, topics), edits)
    if services:
        start, target = systems.with_services(rng, start, target)
    if constraints:
        target = systems.constrained(rng, start, target)
    return between(start, target)


def between(start: Specification, target: Specification) -> Change:
    try:
        return change_between(initial(start), start, target)
    except PlanRefused:
        assume(False)
        raise


def drawn_to_be_hard(seed: int, most: int = 4, services: bool = False) -> Change:
    """Outputs that exchange capped topics, or a start in which something has degraded; every other change each."""
    rng = Random(seed)
    if seed % 2:
        start, target = systems.exclusive(rng, rng.randint(2, most))
    else:
        start, target = systems.change(rng, systems.system(rng, 4, 3), 4)
    if services:
        start, target = systems.with_services(rng, start, target)
    if seed % 2 and rng.random() < 0.7:
        return change_between(initial(start), start, target)
    return change_between(*systems.degraded(rng, start, target))


def planned(change: Change, strategy: str) -> Plan:
    """The plan; it may be refused on account of the user's constraints alone."""
    try:
        return STRATEGIES[strategy](change)
    except PlanRefused as error:
        if not in_force(change) or "constraint" not in str(error):
            raise
        assume(False)
        raise


def holds(plan: Plan) -> None:
    verdict = replay(plan)
    assert verdict.holds, f"{verdict}\n" + "\n".join(str(step) for step in plan.steps)
    for configuration in plan.configurations():
        assert violations(configuration) == []


def test_services_are_handed_over_within_a_role_and_from_one_role_to_another() -> None:
    """What is drawn has both: else little would be tried of the one server that a service has."""
    moved: Counter[str] = Counter()
    for seed in range(40):
        rng = Random(seed)
        ends = systems.exclusive(rng, 3) if seed % 2 else systems.tight(rng, 2)
        start, target = systems.with_services(rng, *ends)
        try:
            plan = STRATEGIES["minimal"](change_between(initial(start), start, target))
        except PlanRefused:
            continue
        for action in (step.action for step in plan.steps):
            for swap in action.swaps if isinstance(action, Handover) else ():
                roles = {plan.change.role_of(swap.old.instance), plan.change.role_of(swap.new.instance)}
                moved[f"{plan.change.start.context.connectors[swap.connector].kind}, {len(roles)}"] += 1
    assert min(moved[f"{kind}, {number}"] for kind in ("service", "action") for number in (1, 2)) > 2, moved


@given(SEEDS, NAMES, st.booleans(), SERVICES)
def test_every_plan_holds(seed: int, strategy: str, constraints: bool, services: bool) -> None:
    holds(planned(drawn(seed, constraints=constraints, services=services), strategy))


@given(specifications(), SEEDS, NAMES)
def test_every_plan_holds_on_drawn_systems(start: Specification, seed: int, strategy: str) -> None:
    rng = Random(seed)
    start, target = systems.change(rng, start, edits=4)
    holds(planned(between(start, target), strategy))


@given(specifications(), specifications(), NAMES)
def test_every_plan_holds_between_any_two_systems(start: Specification, target: Specification, strategy: str) -> None:
    holds(planned(between(start, target), strategy))


@settings(max_examples=40)
@given(SEEDS, NAMES, SERVICES)
def test_every_plan_holds_from_a_degraded_start_and_among_capped_topics(
    seed: int, strategy: str, services: bool
) -> None:
    plan = planned(drawn_to_be_hard(seed, services=services), strategy)
    assert decode_plan(json.loads(json.dumps(encode_plan(plan)))).change == plan.change
    holds(plan)


@settings(max_examples=25)
@given(SEEDS, SERVICES)
def test_minimal_is_as_good_from_a_degraded_start_and_among_capped_topics(seed: int, services: bool) -> None:
    change = drawn_to_be_hard(seed, 3, services)
    try:
        least = Exhaustive(change, 10).optimum()
    except TooLarge:
        assume(False)
    plan = planned(change, "minimal")
    assert plan.disruption == pytest.approx(least)
    assert plan.proved_minimal


@pytest.mark.long
def test_minimal_is_as_good_on_many_degraded_starts_and_capped_topics() -> None:
    costly = {True: 0, False: 0}
    for seed in range(4000):
        change = drawn_to_be_hard(seed, services=seed % 4 > 1)
        try:
            least = Exhaustive(change, 10).optimum()
        except TooLarge:
            continue
        plan = STRATEGIES["minimal"](change)
        assert plan.disruption == pytest.approx(least), f"seed {seed}"
        assert plan.proved_minimal, f"seed {seed}"
        costly[bool(change.lowered)] += bool(least)
    assert min(costly.values()) > 50


@given(SEEDS, NAMES, SERVICES)
def test_the_json_form_says_the_same(seed: int, strategy: str, services: bool) -> None:
    plan = planned(drawn(seed, constraints=True, services=services), strategy)
    document = json.loads(json.dumps(encode_plan(plan)))
    verdict = replay(decode_plan(document))
    assert verdict.holds, verdict
    assert decode_plan(document).steps == plan.steps


@given(SEEDS, NAMES, SEEDS, SERVICES)
def test_steps_that_commute_may_be_taken_in_any_order(seed: int, strategy: str, order: int, services: bool) -> None:
    plan = planned(drawn(seed, services=services), strategy)
    rng, left, done, configuration = Random(order), list(range(len(plan.steps))), set[int](), plan.change.start
    while left:
        index = rng.choice([index for index in left if done.issuperset(plan.dependencies[index])])
        left.remove(index)
        done.add(index)
        configuration = plan.steps[index].action.apply(configuration)
    *_, last = plan.configurations()
    assert configuration == last


@given(SEEDS, NAMES, SERVICES)
def test_the_makespan_is_the_longest_chain_of_dependencies(seed: int, strategy: str, services: bool) -> None:
    plan = planned(drawn(seed, services=services), strategy)
    ends: list[float] = []
    for step, waits in zip(plan.steps, plan.dependencies, strict=True):
        ends.append(max((ends[index] for index in waits), default=0.0) + step.seconds)
    assert plan.makespan == pytest.approx(max(ends, default=0.0))


@settings(max_examples=examples(200))
@given(SEEDS, SERVICES)
@example(108447, False)  # a hand-over on one topic that had better wait for a place on another
@example(109656, False)  # a place given up by one whose replacement is not there yet
def test_minimal_is_as_good_as_every_order_tried(seed: int, services: bool) -> None:
    change = drawn(seed, nodes=4, topics=3, services=services)
    try:
        twin = Exhaustive(change)
    except TooLarge:
        assume(False)
    plan = planned(change, "minimal")
    least = twin.optimum()
    assert least is not None
    assert plan.disruption == pytest.approx(least)
    assert (plan.proved_minimal, plan.lower_bound) == (True, plan.disruption)
    if least == 0.0 and plan.degraded:
        assert twin.optimum(spotless=True) is None


@given(SEEDS, SERVICES)
def test_minimal_is_never_worse_than_the_others(seed: int, services: bool) -> None:
    change = drawn(seed, services=services)
    least = planned(change, "minimal")
    for strategy in sorted(STRATEGIES):
        assert least.disruption <= planned(change, strategy).disruption + 1e-9


@given(SEEDS, SERVICES)
def test_minimal_makes_each_difference_once_and_no_other(seed: int, services: bool) -> None:
    change = drawn(seed, services=services)
    found: list[tuple[str, str]] = []
    for document in encode_plan(planned(change, "minimal"))["steps"]:
        match document["action"]:
            case "create" | "remove":
                found.append((document["action"], document["instance"]))
            case "attach" | "detach":
                found.append((document["action"], f"{document['port']} {document['topic']}"))
            case "handover":
                for swap in document["swaps"]:
                    found.append(("attach", f"{swap['new']} {swap['topic']}"))
                    found.append(("detach", f"{swap['old']} {swap['topic']}"))
    wanted = [("create", instance.name) for instance in change.coming]
    wanted += [("remove", name) for name in change.leaving]
    wanted += [("attach", f"{port} {connector}") for port, connector in change.attached]
    wanted += [("detach", f"{port} {connector}") for port, connector in change.detached]
    assert sorted(found) == sorted(wanted)


@given(SEEDS)
def test_without_a_conflict_nothing_falls(seed: int) -> None:
    rng = Random(seed)
    start, target = systems.change(rng, systems.system(rng), 5)
    plan = planned(between(systems.unbounded(start), systems.unbounded(target)), "minimal")
    assert (plan.disruption, plan.degraded, plan.proved_minimal) == (0.0, (), True)


@given(SEEDS)
def test_no_change_is_no_plan(seed: int) -> None:
    rng = Random(seed)
    start, _ = systems.change(rng, systems.system(rng))
    change = between(start, start)
    assert not (change.instances() or change.parameters or change.pending)
    for strategy in sorted(STRATEGIES):
        assert STRATEGIES[strategy](change).steps == ()


@given(SEEDS, SERVICES)
def test_a_change_of_some_roles_is_the_same_either_way(seed: int, services: bool) -> None:
    """What costs the change finds the same as what walks the system."""
    rng = Random(seed)
    start, target = systems.change(rng, systems.system(rng), 4, world=False)
    if services:
        start, target = systems.with_services(rng, start, target)
    configuration = initial(start)
    roles = [r for r in {*start.nodes, *target.nodes} if start.nodes.get(r) != target.nodes.get(r)]
    roles += [
        r
        for r in target.nodes
        if r in start.nodes and start.components.get(start.nodes[r].component) != target.component_of(r)
    ]
    one, other = change_of_roles(configuration, start, target, roles), change_between(configuration, start, target)
    assert one.final == other.final
    assert one == other


@given(SEEDS, NAMES, SERVICES)
def test_the_running_names_do_not_matter(seed: int, strategy: str, services: bool) -> None:
    """A change after a change: instances that bear other names than their roles."""
    rng = Random(seed)
    first, second = systems.change(rng, systems.system(rng), 4)
    if services:
        first, second = systems.with_services(rng, first, second)
    plan = planned(between(first, second), "minimal")
    *_, last = plan.configurations()
    running = plan.change.in_target_context(last)
    try:
        back = change_between(running, second, first)
    except PlanRefused:
        assume(False)
    plan = planned(back, strategy)
    holds(plan)
    assert replay(decode_plan(encode_plan(plan))).holds


def instances(wanted: int, fewest: int, most: int, replaced: int) -> Iterator[tuple[int, Change, Exhaustive]]:
    """So many changes with between ``fewest`` and ``most`` structural differences, every other one tight.

    Half of each have services.
    """
    found, seed = {True: 0, False: 0}, 0
    while sum(found.values()) < wanted:
        seed += 1
        rng, tight = Random(seed), seed % 2 == 0
        if 2 * found[tight] >= wanted + 1:
            continue
        if tight:
            start, target = systems.tight(rng, rng.randint(2, replaced))
        else:
            start, target = systems.change(rng, systems.system(rng, 4, 3), 5)
        if seed % 4 > 1:
            start, target = systems.with_services(rng, start, target)
        change = change_between(initial(start), start, target)
        try:
            twin = Exhaustive(change, most)
        except TooLarge:
            continue
        if len(twin.all) >= fewest:
            found[tight] += 1
            yield seed, change, twin


@pytest.mark.long
@pytest.mark.parametrize(
    ("wanted", "fewest", "most", "replaced"),
    [
        (int(os.environ.get("MIDSTRIDE_SMALL_INSTANCES", "5000")), 1, 10, 3),
        (int(os.environ.get("MIDSTRIDE_LARGE_INSTANCES", "150")), 12, 16, 4),
    ],
    ids=["small", "large"],
)
def test_minimal_finds_the_optimum_and_proves_it(wanted: int, fewest: int, most: int, replaced: int) -> None:
    number = conflicts = 0
    for seed, change, twin in instances(wanted, fewest, most, replaced):
        least, plan = twin.optimum(), STRATEGIES["minimal"](change)
        assert least is not None
        assert plan.disruption == pytest.approx(least), f"seed {seed}"
        assert (plan.proved_minimal, plan.lower_bound) == (True, plan.disruption), f"seed {seed}"
        holds(plan)
        number += 1
        conflicts += least > 0.0
    assert number >= wanted
    assert conflicts > wanted / 10


def is_circle(constraint: Constraint) -> bool:
    """`order a before a`, which `check` does not let through."""
    return isinstance(constraint, Order) and constraint.first == constraint.then


@pytest.mark.long
def test_minimal_meets_the_constraints_that_can_be_met() -> None:
    """It refuses only what no order of the steps meets; and what it plans costs no more than it must."""
    met = refused = 0
    for seed in range(8000):
        rng = Random(seed)
        start, target = systems.change(rng, systems.system(rng, 4, 3), 4)
        if seed % 2:
            start, target = systems.with_services(rng, start, target)
        asked = systems.constrained(rng, start, target).constraints
        decidable = tuple(c for c in asked if not (isinstance(c, Limit) and c.seconds) and not is_circle(c))
        change = change_between(initial(start), start, replace(target, constraints=decidable))
        if not in_force(change):
            continue
        try:
            least = Constrained(change).optimum()
        except TooLarge:
            continue
        disruption, told = None, "planned"
        try:
            disruption = STRATEGIES["minimal"](change).disruption
        except PlanRefused as error:
            told = str(error)
        assert disruption == (None if least is None else pytest.approx(least)), f"seed {seed}: {told}"
        refused += least is None
        met += least is not None and least > 0.0
    assert min(met, refused) > 50


SCRIPT = """
import json, sys
from tests.plan.test_random import drawn
from midstride.plan.forms.plan_forms import encode_plan
from midstride.plan.strategies.registry import STRATEGIES
for seed in (3, 8, 11, 59):
    print(json.dumps([encode_plan(STRATEGIES[name](drawn(seed))) for name in sorted(STRATEGIES)]))
"""


def test_plans_do_not_depend_on_how_strings_hash() -> None:
    def run(hash_seed: str) -> str:
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
        root = Path(__file__).parents[2]
        environment["PYTHONPATH"] = os.pathsep.join([str(root), *sys.path])
        done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment, cwd=root)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert run("1") == run("2") == run("3")


@pytest.mark.parametrize(
    ("seed", "size", "least"),
    [
        # Plans that are as good so far are followed on, since they may take less time.
        (150, (3, 3, 4), (12.75, 3, 3.36, 11)),
        (1183, (3, 3, 4), (0.0, 1, 2.51, 8)),
        # Disruption comes before the number of functionalities that fall.
        (2123, (3, 3, 4), (5.0, 2, 2.75, 7)),
        # The most promising state is followed first, which matters where the number of trials is short.
        (70, (10, 5, 10), (0.0, 0, 1.01, 15)),
    ],
)
def test_the_search_finds_plans_as_good_as_these(
    seed: int, size: tuple[int, int, int], least: tuple[float, int, float, int]
) -> None:
    """Each is missed by a search that decides one thing otherwise."""
    nodes, topics, edits = size
    plan = STRATEGIES["minimal"](drawn(seed, nodes=nodes, topics=topics, edits=edits))
    assert (plan.disruption, len(plan.degraded), plan.makespan, len(plan.steps)) <= least
