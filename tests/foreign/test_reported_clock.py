"""How `/clock` moves, as others report: what is due on it, and what is not known."""

from __future__ import annotations

import pytest

from midstride.foreign import reported_states
from midstride.foreign.reported_states import FRESH, UNNOTICED, ReportedStates
from midstride.wire.state import ComponentState
from tests.wire.bare_state import bare_state


class Time:
    """In the place of the module `time`."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    made = Time()
    monkeypatch.setattr(reported_states, "time", made)
    return made


def state(speed: float, *, simulated: bool = True) -> ComponentState:
    return bare_state("talker", uuid="1", revision=0, simulated_time=simulated, clock_speed=speed)


def reports(clock: ReportedStates, time: Time, speed: float, seconds: float) -> None:
    """Twice a second, for so long."""
    for _ in range(int(2 * seconds)):
        clock.note(state(speed))
        time.now += 0.5


def test_nothing_is_due_on_a_clock_of_which_nothing_is_known(time: Time) -> None:
    clock = ReportedStates()
    assert (clock.speed, clock.due(60.0)) == (0.0, None)
    clock.note(state(1.0, simulated=False))
    assert (clock.speed, clock.due(60.0)) == (0.0, None)
    reports(clock, time, 1.0, 60.0)
    time.now += FRESH
    assert (clock.speed, clock.due(60.0)) == (0.0, None), "nothing has reported for too long"
    clock.note(state(1.0))
    assert clock.due(60.0) == 0.0, "what was in between is not known"


@pytest.mark.parametrize(("speed", "factor"), [(0.1, 0.1), (1.0, 1.0), (20.0, 1.0)])
def test_time_counts_while_it_moves_and_longer_where_it_is_slow(time: Time, speed: float, factor: float) -> None:
    clock = ReportedStates()
    reports(clock, time, speed, 60.0)
    assert clock.due(1.0) == 0.0, "it may have been stopped just now"
    assert clock.due(20.0) == pytest.approx((20.0 - UNNOTICED) * factor)
    assert clock.due(1000.0) == pytest.approx((60.0 - UNNOTICED) * factor)


def test_a_pause_does_not_count(time: Time) -> None:
    clock = ReportedStates()
    reports(clock, time, 1.0, 60.0)
    reports(clock, time, 0.0, 60.0)
    assert clock.due(60.0) is None
    reports(clock, time, 1.0, 10.0)
    assert clock.due(70.0) == pytest.approx(10.0 - UNNOTICED)
