"""How good the plans are that follow the core, and those of the search by moves alone.

The figures are those of today's planner: a fault in it makes plans that are valid and worse, which nothing else shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

import pytest

from midstride.errors import PlanRefused
from midstride.model.specification import Constraint, Keep
from midstride.plan.change import Change
from midstride.plan.core.core_plan import Budget, search_core
from midstride.plan.disruption import Levels
from midstride.plan.strategies.minimal import _find, cheapest_along
from tests.plan.test_core import between
from tests.plan.test_core_bounds import FAMILIES


def changes(family: str, replaced: int, seeds: range) -> Iterator[Change]:
    for seed in seeds:
        try:
            yield between(FAMILIES[family](Random(seed), replaced))
        except PlanRefused:
            continue


def kept(change: Change) -> tuple[Constraint, ...]:
    """No functionality may be below the modes that it begins and ends in."""
    levels, specification = Levels(change), change.specification
    return tuple(
        Keep(counted.ref, modes[counted.baseline].name)
        for role in sorted(specification.nodes)
        for counted in levels.counted(role)
        if counted.baseline
        < len(modes := specification.component_of(role).functionalities[counted.ref.functionality].modes)
    )


@pytest.mark.parametrize(
    ("family", "replaced", "keep", "figures"),
    [
        ("tight", 3, False, (59, 59, 50)),
        ("exclusive", 4, False, (34, 34, 39)),
        ("exclusive", 4, True, (19, 19, 0)),
        ("shared", 3, False, (59, 59, 33)),
    ],
)
def test_a_plan_along_the_core_loses_what_the_core_does(
    family: str, replaced: int, keep: bool, figures: tuple[int, int, int]
) -> None:
    """Figures: the plans, those that lose no more than the bound, and the functionalities that fall in all of them."""
    plans = least = fallen = 0
    for change in changes(family, replaced, range(60)):
        levels, constraints = Levels(change), kept(change) if keep else ()
        core = search_core(levels, constraints, Budget())
        found = cheapest_along(core, levels, constraints)
        if found is None:
            continue
        assert found.disruption >= core.lower_bound - 1e-6
        plans += 1
        least += found.disruption <= core.lower_bound + 1e-6 and not found.breaches
        fallen += found.key[2]
    assert (plans, least, fallen) == figures


@pytest.mark.parametrize(
    ("family", "replaced", "figures"),
    [
        ("tight", 3, (40, 202.25, 30, 621)),
        pytest.param("exclusive", 4, (40, 227.75, 29, 677), marks=pytest.mark.full),
        ("shared", 3, (40, 135.6, 23, 447)),
    ],
)
def test_the_search_by_moves_alone_finds_plans_that_lose_little(
    family: str, replaced: int, figures: tuple[int, float, int, int]
) -> None:
    """Figures: the plans, what they lose in all, the functionalities that fall, and the steps."""
    found = [_find(Levels(change), (), None, few=False) for change in changes(family, replaced, range(40))]
    keys = [candidate.key for candidate in found if candidate is not None]
    assert not any(broken for broken, *_ in keys)
    lost, fallen, steps = (sum(key[place] for key in keys) for place in (1, 2, 4))
    assert (len(keys), round(lost, 6), fallen, steps) == figures
