"""Programs that end (`once`) in plans: they run last, cost nothing, and the plans are valid with them and without."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from random import Random

import pytest
from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.action import Create, Remove
from midstride.model.component import ComponentSpec
from midstride.model.specification import Order, Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.overlap import duration, one_by_one, overlap
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan import systems
from tests.plan.cases import component, functionality, sound, system
from tests.plan.exhaustive import Constrained, TooLarge

FEW_AND_MANY = pytest.mark.parametrize("seeds", [range(30), pytest.param(range(30, 300), marks=pytest.mark.full)])
# The exhaustive twin visits so many states at most.
MOST = 4_000


def changes(seeds: range) -> Iterator[tuple[int, Change, Change]]:
    """Random changes with programs, and the same without them."""
    for seed in seeds:
        rng = Random(seed)
        plain = systems.change(rng, systems.system(rng, 4, 3), 4)
        start, target = systems.with_programs(rng, *plain)
        try:
            yield seed, change_between(initial(start), start, target), change_between(initial(plain[0]), *plain)
        except PlanRefused:
            continue


def programs(plan: Plan) -> list[int]:
    """The steps of programs."""
    return [
        index
        for index, step in enumerate(plan.steps)
        if (isinstance(step.action, Create) and step.action.instance.component.once)
        or (isinstance(step.action, Remove) and plan.change.component_of(step.action.instance).once)
    ]


@FEW_AND_MANY
@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
def test_plans_are_sound_and_programs_are_last_and_lose_nothing(strategy: str, seeds: range) -> None:
    met = 0
    for seed, change, plain in changes(seeds):
        try:
            plan, without = STRATEGIES[strategy](change), STRATEGIES[strategy](plain)
        except PlanRefused:
            continue
        sound(plan)
        found = programs(plan)
        assert found == list(range(len(plan.steps) - len(found), len(plan.steps))), f"seed {seed}"
        if strategy == "minimal" and plan.proved_minimal and without.proved_minimal:
            assert plan.disruption == pytest.approx(without.disruption), f"seed {seed}"
        met += bool(found)
    assert met > len(seeds) / 4


@pytest.mark.parametrize("seeds", [range(5), pytest.param(range(5, 40), marks=pytest.mark.full)], ids=str)
def test_the_exhaustive_twin_finds_the_same_least_disruption(seeds: range) -> None:
    compared = 0
    for seed, change, _ in changes(seeds):
        try:
            least = Constrained(change, MOST).optimum()
        except TooLarge:
            continue
        try:
            plan = STRATEGIES["minimal"](change)
        except PlanRefused:
            assert least is None, f"seed {seed}"
            continue
        assert plan.disruption == pytest.approx(least), f"seed {seed}"
        compared += bool(programs(plan))
    assert compared > 1


@FEW_AND_MANY
def test_no_program_starts_before_its_step_and_those_side_by_side_run_at_once(seeds: range) -> None:
    for _, change, _ in changes(seeds):
        try:
            plan = STRATEGIES["minimal"](change)
        except PlanRefused:
            continue
        found = [index for index in programs(plan) if isinstance(plan.steps[index].action, Create)]
        for overlapping in (overlap(plan), one_by_one([step.action for step in plan.steps])):
            assert not {index for starts in overlapping.starts.values() for index in starts} & set(found)
        together = [some for some in overlap(plan).rounds if set(some) & set(found)]
        assert sum(len(set(some) & set(found)) for some in together) == len(found)
        assert duration(plan).seconds <= plan.seconds + 1e-6


def setting_up(*orders: Order) -> Specification:
    driver = component("Driver", functionality("drive", outputs=["out"]), run="./driver")
    program = ComponentSpec.of("Setup", run="./setup", once=True, gate="none")
    nodes = {"driver": ("Driver", {"out": "/out"}), "setup": ("Setup", {}), "after": ("Setup", {})}
    return replace(system([driver, program], nodes), constraints=orders)


def roles(specification: Specification) -> list[str]:
    nothing = replace(specification, nodes=Map(), constraints=())
    plan = sound(STRATEGIES["minimal"](change_between(initial(nothing), nothing, specification)))
    return list(dict.fromkeys(step.roles[0] for step in plan.steps))


def test_an_order_puts_a_program_and_those_before_it_before_a_node() -> None:
    assert roles(setting_up()) == ["driver", "after", "setup"]
    assert roles(setting_up(Order("setup", "driver"))) == ["setup", "driver", "after"]
    assert roles(setting_up(Order("setup", "driver"), Order("after", "setup"))) == ["after", "setup", "driver"]
    assert roles(setting_up(Order("driver", "setup"), Order("setup", "after"))) == ["driver", "setup", "after"]


def test_a_program_is_run_by_its_name_and_when_its_command_changes_and_otherwise_not() -> None:
    start = setting_up()
    setup = start.components["Setup"]
    other = replace(start, components=start.components.set("Setup", replace(setup, run="./setup --again")))

    def created(target: Specification, request: PlanRequest) -> list[str]:
        change = change_between(initial(start), start, target, renewed=request.renewed(target))
        return sorted(instance.name for instance in change.coming)

    assert created(start, PlanRequest(to=start)) == []
    assert created(start, PlanRequest(restart=("setup",))) == ["setup_2"]
    assert created(other, PlanRequest(to=other)) == ["after_2", "setup_2"]
    assert created(start, PlanRequest(restart=("driver",), strategy="stop")) == ["driver_2"]
    assert created(start, PlanRequest(restart=("driver", "after"), strategy="stop")) == ["after_2", "driver_2"]
