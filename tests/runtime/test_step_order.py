"""The order of the steps of a change of which some wait, and some are left out: against the obvious rule."""

from __future__ import annotations

import random

import pytest

from midstride.runtime.change.step_order import StepOrder


def obviously_needs(dependencies: list[list[int]], step: int, others: set[int]) -> bool:
    return step in others or any(obviously_needs(dependencies, each, others) for each in dependencies[step])


@pytest.mark.parametrize("seed", range(60))
def test_a_step_is_taken_after_those_it_needs_and_no_other_waits(seed: int) -> None:
    draw = random.Random(seed)
    count = draw.randint(1, 12)
    dependencies = [[each for each in range(step) if draw.random() < 0.2] for step in range(count)]
    rounds: list[tuple[int, ...]] = []
    for step in range(count):
        if rounds and draw.random() < 0.5 and not {*rounds[-1]}.intersection(dependencies[step]):
            rounds[-1] += (step,)
        else:
            rounds.append((step,))
    last = frozenset(range(draw.randint(count // 2, count), count))
    order = StepOrder([*rounds], lambda: dependencies, last)
    taken: list[int] = []

    def deferred(steps: set[int]) -> set[int]:
        """Those that wait for some of these."""
        return {step for step in range(count) if obviously_needs(dependencies, step, steps)} - steps

    late: set[int] = set()
    left_out: set[int] = set()
    waited: set[int] = set()
    while (found := order.next()) is not None or order.late:
        if found is None:
            first = draw.choice(order.late)
            order.resume(first)
            late.discard(first)
            continue
        for step in found:
            assert {*dependencies[step]} <= {*taken}
            assert not obviously_needs(dependencies, step, late | left_out)
            assert step not in last or late | deferred(left_out) <= last, "it is taken after all others"
        others = {*range(count)} - {*taken, *found}
        after = {step for step in others if obviously_needs(dependencies, step, {*found} | left_out)}
        alone = {*found} | deferred({*found} | left_out) <= last
        assert order.leaves(found) == bool(others - after - (set() if alone else last))
        if len(found) == 1 and found[0] not in waited and draw.random() < 0.3:
            waited.add(found[0])
            late.add(found[0])
            order.postpone(found[0])
        elif draw.random() < 0.1:
            left_out.update(found)
            order.leave_out(found)
        else:
            taken += found
    assert order.ended
    rest = {*range(count)} - {*taken}
    skipped = {step for step in range(count) if obviously_needs(dependencies, step, left_out)}
    assert rest - skipped <= last
    assert rest == skipped | (set() if deferred(left_out) <= last else last - {*taken})
