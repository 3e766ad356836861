"""The offset of another host's clock, by its slow and obvious twin: every offset that no exchange excludes."""

from __future__ import annotations

import random

import pytest

from midstride.wire.clock_offset import DRIFT, ClockAnswer, ClockOffset, clock_offset

MS = 10**6


def exchanges(drawn: random.Random, ahead: int) -> list[ClockAnswer]:
    """Questions to a clock that is ``ahead``, with ways there and back of any lengths."""
    found, now = [], drawn.randrange(10**12)
    for _ in range(drawn.randrange(1, 9)):
        there, back = (drawn.randrange(1, 20 * MS) for _ in range(2))
        found.append(ClockAnswer(now, now + there + ahead, now + there + back))
        now += there + back + drawn.randrange(MS)
    return found


def possible(found: list[ClockAnswer]) -> tuple[int, int]:
    """The least and the greatest offset, of the exchange that leaves the fewest: the clock was read during it."""
    ranges = [(each.other - each.answered, each.other - each.asked) for each in found]
    return min(ranges, key=lambda each: each[1] - each[0])


@pytest.mark.parametrize("seed", range(200))
def test_the_true_offset_is_within_its_uncertainty(seed: int) -> None:
    drawn = random.Random(seed)
    ahead = drawn.choice((0, 1, -1)) * drawn.randrange(10**10)
    found = exchanges(drawn, ahead)
    offset = clock_offset(found)
    assert offset is not None and abs(offset.ahead - ahead) <= offset.uncertainty
    least, greatest = possible(found)
    assert offset.ahead - offset.uncertainty <= least + 1 and offset.ahead + offset.uncertainty >= greatest - 1
    assert offset.to_here(offset.to_other(5)) == 5
    assert abs(offset.to_other(found[0].asked) - (found[0].asked + ahead)) <= offset.uncertainty


def test_two_clocks_drift_apart() -> None:
    offset = ClockOffset(3, 10, at=10**9)
    assert offset.uncertainty_at(10**9) == 10
    assert offset.uncertainty_at(11 * 10**9) == offset.uncertainty_at(-9 * 10**9) == 10 + round(DRIFT * 10**10)


def test_without_an_exchange_nothing_is_known() -> None:
    assert clock_offset([]) is None
    assert clock_offset([ClockAnswer(5, 0, 4)]) is None
