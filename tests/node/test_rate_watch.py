"""Whether an output keeps its rate: bursts and stalls do not pass, jitter does, and what is unclear is neither."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from midstride.node.control.rate_watch import RateWatch

RATE, WINDOW = 10.0, 2.0


def watched(times: Iterable[float], until: float, rate: float = RATE) -> RateWatch:
    """The watch at ``until`` (s), having seen messages at ``times``; it looks every 5 ms."""
    due, watch, written = sorted(times), RateWatch(rate, WINDOW, 0), 0
    for tick in range(int(until * 200) + 1):
        while written < len(due) and due[written] <= tick / 200:
            written += 1
        watch.see(written, tick * 5_000_000)
    return watch


def steady(begin: float, end: float, rate: float = RATE) -> list[float]:
    return [begin + n / rate for n in range(int((end - begin) * rate))]


@pytest.mark.parametrize("seed", range(20))
def test_a_rate_with_jitter_is_kept(seed: int) -> None:
    jitter = random.Random(seed)
    watch = watched([at + jitter.uniform(0, 0.09) for at in steady(0, 4)], 3.9)
    assert watch.kept and not watch.broken


def test_nothing_is_concluded_before_a_window_is_complete() -> None:
    watch = watched(steady(0, 4), WINDOW - 0.1)
    assert not watch.kept and not watch.broken


@pytest.mark.parametrize(
    ("times", "broken"),
    [
        (steady(0, 4, 8), False),  # too slow to be let in, and not slow enough to be taken out again
        (steady(0, 4, 6), True),
        ([*steady(0, 3), *steady(3.5, 4)], False),  # a stall
        ([*steady(0, 2.4), *[3.6 + n / 100 for n in range(30)]], True),  # a stall, and a burst that makes up for it
        ([n + m / 1000 for n in range(4) for m in range(10)], False),  # bursts: ten messages each second
        ([n * 2.0 + m / 1000 for n in range(2) for m in range(20)], True),
        ([], True),
    ],
)
def test_what_is_slow_or_comes_in_bursts_is_not_kept(times: list[float], broken: bool) -> None:
    seen = [watched(times, at / 10) for at in range(22, 39, 2)]
    assert not any(watch.kept for watch in seen[-3:]) and any(watch.broken for watch in seen) == broken


def test_what_was_wrong_before_the_window_is_forgotten() -> None:
    assert watched([0.0, 0.9, *steady(2, 6)], 4.2).kept


def test_a_clock_that_is_set_back_begins_again() -> None:
    watch = watched(steady(0, 4), 3)
    watch.see(30, 0)
    assert not watch.complete and not watch.kept and watch.rate == 0


def test_without_a_rate_nothing_is_broken() -> None:
    watch = watched([], 4, rate=0.0)
    assert not watch.broken


@pytest.mark.parametrize(("written", "kept"), [(17, True), (16, False)])
def test_nine_tenths_of_the_messages_but_one_are_enough(written: int, kept: bool) -> None:
    """That one may be late."""
    watch = RateWatch(RATE, WINDOW, 0)
    for number in range(1, written + 1):
        watch.see(number, number * 115_000_000)
    watch.see(written, int(WINDOW * 1e9))
    assert watch.kept == kept
