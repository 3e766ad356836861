"""The two slow twins of ``minimal``, an exhaustive search and a logic program, find the same optimum."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from random import Random

import pytest

from midstride.errors import PlanRefused
from midstride.model.specification import Constraint, Limit, Order, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from tests.plan import systems
from tests.plan.exhaustive import Constrained, TooLarge

pytest.importorskip("clingo")

from tests.plan.answer_sets import AnswerSets  # needs clingo


def decidable(constraint: Constraint) -> bool:
    """Whether it depends on the states on the way alone, and `check` lets it through."""
    if isinstance(constraint, Order):
        return constraint.first != constraint.then
    return not (isinstance(constraint, Limit) and constraint.seconds)


def changes(seeds: range) -> Iterator[tuple[int, Change]]:
    """Every third tight, every third with constraints; of each, every other one with services."""
    for seed in seeds:
        rng = Random(seed)
        if seed % 3 == 0:
            start, target = systems.tight(rng, rng.randint(2, 3))
        else:
            start, target = systems.change(rng, systems.system(rng, 4, 3), 4)
        if seed % 2:
            start, target = systems.with_services(rng, start, target)
        if seed % 3 == 1:
            asked = systems.constrained(rng, start, target).constraints
            target = replace(target, constraints=tuple(filter(decidable, asked)))
        try:
            yield seed, change_between(initial(start), start, target)
        except PlanRefused:
            continue


def agree(seeds: range, most: int) -> tuple[int, int]:
    """How many changes cost something, and how many are impossible; the twins agree on all."""
    costly = impossible = 0
    for seed, change in changes(seeds):
        try:
            least = Constrained(change, most).optimum()
        except TooLarge:
            continue
        other = AnswerSets(change).optimum()
        assert other == (None if least is None else pytest.approx(least)), f"seed {seed}"
        costly += bool(least)
        impossible += least is None
    return costly, impossible


def test_the_twins_agree() -> None:
    costly, impossible = agree(range(60), most=8)
    assert costly > 5
    assert impossible > 0


@pytest.mark.long
def test_the_twins_agree_on_many_systems() -> None:
    costly, impossible = agree(range(6000), most=10)
    assert costly > 500
    assert impossible > 50
