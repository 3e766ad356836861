"""Rate, age and jitter of one attachment, on a clock that the test sets."""

from __future__ import annotations

import itertools
import random

import pytest

from midstride.node.author.message_times import KEPT, MessageTimes, window_of
from midstride.wire.state import Measured

MS = 1_000_000
START = 1_000_000_000_000


class Endpoint:
    """An attachment, and the clock of its node (ns)."""

    def __init__(self, now: int = START) -> None:
        self.now = now
        self.times = MessageTimes(lambda: self.now)

    def message(self, after: float = 0) -> None:
        """A message, ``after`` milliseconds from now."""
        self.now += round(after * MS)
        self.times.mark()

    def messages(self, count: int, every: float) -> None:
        for _ in range(count):
            self.message(every)

    def later(self, milliseconds: float, window: float = 1.0) -> Measured:
        self.now += round(milliseconds * MS)
        return self.times.measured(window)


def test_nothing_is_known_before_the_first_message_nor_a_rate_before_the_second() -> None:
    endpoint = Endpoint()
    assert endpoint.later(5) == Measured(window=1.0, covered=0.005)
    assert endpoint.times.age() is None
    endpoint.message()
    assert endpoint.later(30) == Measured(window=1.0, covered=0.035, age=0.03)
    assert endpoint.times.age() == 0.03


@pytest.mark.parametrize("phase", [0, 1, 9.9, 19.999])
@pytest.mark.parametrize("count", [3, 40, 200])
def test_the_rate_of_a_regular_publisher_is_exact_at_any_moment(count: int, phase: float) -> None:
    endpoint = Endpoint()
    endpoint.messages(count, every=20)
    found = endpoint.later(phase)
    assert found.rate == pytest.approx(50)
    assert found.jitter == pytest.approx(0, abs=1e-12)
    assert found.longest == pytest.approx(0.02)
    assert found.age == pytest.approx(phase / 1e3)
    assert found.covered == pytest.approx(min(1.0, count * 0.02 + phase / 1e3))


def test_a_rate_of_0_is_known_once_a_whole_window_had_no_message() -> None:
    endpoint = Endpoint()
    assert endpoint.later(999) == Measured(window=1.0, covered=0.999)
    assert endpoint.later(1) == Measured(window=1.0, covered=1.0, rate=0.0)


def test_the_rate_of_a_publisher_that_stops_falls_to_0_within_the_window() -> None:
    endpoint = Endpoint()
    endpoint.messages(100, every=20)
    rates = [endpoint.later(10).rate or 0.0 for _ in range(101)]
    assert all(later <= earlier for earlier, later in itertools.pairwise(rates))
    assert rates[49] == pytest.approx(25, abs=2)
    assert rates[-1] == 0
    found = endpoint.later(0)
    assert found.longest == found.age == pytest.approx(1.01)


def test_a_publisher_that_comes_back_regains_its_rate_over_one_window() -> None:
    endpoint = Endpoint()
    endpoint.messages(100, every=20)
    endpoint.now += 60_000 * MS
    endpoint.messages(25, every=20)
    assert endpoint.later(0).rate == pytest.approx(25, abs=2)
    assert endpoint.later(0).longest == pytest.approx(60.02)
    endpoint.messages(26, every=20)
    assert endpoint.later(0).rate == pytest.approx(50)


def test_a_slowdown_shows_within_a_few_periods() -> None:
    endpoint = Endpoint()
    endpoint.messages(100, every=20)
    endpoint.messages(2, every=100)
    rate = endpoint.later(0).rate
    assert rate is not None
    assert 40 < rate < 45


def test_bursts_have_the_right_rate_and_show_in_jitter_and_in_the_longest_gap() -> None:
    endpoint = Endpoint()
    for _ in range(20):
        endpoint.message(191)
        endpoint.messages(9, every=1)
    found = endpoint.later(0)
    assert found.rate == pytest.approx(50, rel=0.05)
    assert found.longest == pytest.approx(0.191)
    assert found.jitter == pytest.approx(0.057, abs=0.003)


def test_jitter_is_the_standard_deviation_of_the_times_between_messages() -> None:
    endpoint = Endpoint()
    endpoint.messages(1, every=20)
    for _ in range(10):
        endpoint.message(15)
        endpoint.message(25)
    found = endpoint.later(0)
    assert found.rate == pytest.approx(50)
    assert found.jitter == pytest.approx(0.005)
    assert found.longest == pytest.approx(0.025)


def test_random_times_agree_with_counting_them() -> None:
    """Over a long window, the rate is the number of messages by the time they took."""
    choose = random.Random(7)
    for _ in range(200):
        endpoint = Endpoint()
        gaps = [choose.uniform(0.1, 30) for _ in range(choose.randrange(300, 600))]
        for gap in gaps:
            endpoint.message(gap)
        counted = len(gaps) / (sum(gaps) / 1e3)
        found = endpoint.later(0, window=choose.uniform(2, 20))
        assert found.rate == pytest.approx(counted, rel=0.25)
        assert found.longest is not None
        assert found.longest <= max(gaps) / 1e3 + 1e-9


def test_many_messages_at_one_moment_of_a_coarse_clock_count() -> None:
    """/clock ticks at 100 Hz, and messages come at 500 Hz."""
    endpoint = Endpoint()
    for _ in range(200):
        endpoint.now += 10 * MS
        endpoint.messages(5, every=0)
    assert endpoint.later(0).rate == pytest.approx(500, rel=0.02)
    endpoint = Endpoint()
    endpoint.messages(5, every=0)
    assert endpoint.later(0).rate is None


def test_the_measurement_starts_afresh_where_the_clock_jumps_back() -> None:
    endpoint = Endpoint()
    endpoint.messages(100, every=20)
    endpoint.now -= 500 * MS
    assert endpoint.later(0) == Measured(window=1.0)
    assert endpoint.times.age() is None
    endpoint.messages(3, every=10)
    found = endpoint.later(0)
    assert found.rate == pytest.approx(100)
    assert found.covered == pytest.approx(0.03)


def test_messages_before_the_clock_runs_do_not_count() -> None:
    endpoint = Endpoint(now=0)
    endpoint.messages(100, every=0)
    assert endpoint.later(0) == Measured(window=1.0)
    endpoint.now = START
    assert endpoint.later(0) == Measured(window=1.0)
    endpoint.messages(3, every=100)
    found = endpoint.later(0)
    assert found.rate == pytest.approx(10)
    assert found.longest == pytest.approx(0.1)


def test_no_message_is_due_while_a_simulation_is_paused() -> None:
    endpoint = Endpoint()
    endpoint.messages(100, every=20)
    before = endpoint.later(0)
    assert endpoint.later(0) == before


def test_at_a_high_rate_the_last_messages_are_measured() -> None:
    endpoint = Endpoint()
    endpoint.messages(20_000, every=0.1)
    found = endpoint.later(0)
    assert found.rate == pytest.approx(10_000)
    assert found.covered == found.window == pytest.approx((KEPT - 1) / 10_000)
    assert found.meets(10_000) is True


def test_the_window_has_ten_periods_and_at_least_a_second() -> None:
    assert [window_of(rate) for rate in (1000.0, 50.0, 10.0, 2.0, 0.1, None)] == [1, 1, 1, 5, 100, 10]


def test_a_single_message_in_a_whole_window_is_a_rate() -> None:
    endpoint = Endpoint()
    endpoint.now += 5_000 * MS
    endpoint.message()
    assert endpoint.later(10).rate == pytest.approx(1)


def test_a_measurement_that_starts_afresh_covers_nothing_yet() -> None:
    endpoint = Endpoint()
    endpoint.messages(100, every=20)
    endpoint.times.restart()
    assert endpoint.later(0) == Measured(window=1.0)
    endpoint.messages(10, every=10)
    found = endpoint.later(0)
    assert found.rate == pytest.approx(100)
    assert found.covered == pytest.approx(0.1)


def test_a_declared_rate_is_met_to_within_a_tenth_once_a_window_is_measured() -> None:
    endpoint = Endpoint()
    endpoint.messages(40, every=20)
    assert endpoint.later(0).meets(50) is None
    endpoint.messages(40, every=20)
    found = endpoint.later(0)
    assert [found.meets(rate) for rate in (10, 50, 55, 56)] == [True, True, True, False]
    assert endpoint.later(1_000).meets(0.001) is False
