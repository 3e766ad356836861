"""The timer on a grid, against rcl's own rules for a timer without one (rcl/src/rcl/timer.c), in virtual time."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from midstride.backends.ros2.component.timers import TOLERANCE, Ros2GridTimer, SetBackWatch

PERIOD = 20_000_000
START = 1_000_000_000_000


class World:
    """A clock, and a node whose executor calls what is due when it is looked at."""

    def __init__(self, now: int = START, cost: int = 300) -> None:
        self.time = now
        self.cost = cost  # of looking at the clock
        self.hiccup: Callable[[], int] = lambda: 0
        self.timers: list[RclTimer] = []

    def now(self) -> int:
        if self.time:
            self.time += self.cost + self.hiccup()
        return self.time

    def create_timer(self, period: float, callback: Callable[[], None], callback_group: object) -> RclTimer:
        self.timers.append(RclTimer(self, round(period * 1e9), callback))
        return self.timers[-1]

    def destroy_timer(self, timer: RclTimer) -> None:
        self.timers.remove(timer)

    def spin(self) -> None:
        for timer in list(self.timers):
            if timer in self.timers and timer.next <= self.time:
                timer.call()

    def until(self, time: int) -> None:
        """Time goes by, with the executor awake."""
        while True:
            upcoming = min((timer.next for timer in self.timers), default=time + 1)
            if upcoming > time:
                break
            self.time = max(self.time, upcoming)
            self.spin()
        self.time = max(self.time, time)

    def asleep_until(self, time: int) -> None:
        """Time goes by, with the executor busy elsewhere."""
        self.time = time

    def jump(self, time: int) -> None:
        """What rcl does to a timer when `/clock` sets its clock back by more than a period.

        It does nothing where the system's clock is set back, as there rcl does not notice.
        """
        self.time = time
        for timer in self.timers:
            if time < timer.last:
                timer.last, timer.next = time, time + timer.period


class RclTimer:
    def __init__(self, world: World, period: int, callback: Callable[[], None]) -> None:
        self.world, self.period, self.callback = world, period, callback
        self.last = world.time
        self.next = world.time + period

    @property
    def timer_period_ns(self) -> int:
        return self.period

    @timer_period_ns.setter
    def timer_period_ns(self, period: int) -> None:
        self.period = period

    def reset(self) -> None:
        self.next = self.world.now() + self.period

    def cancel(self) -> None:
        pass

    def time_until_next_call(self) -> int:
        return self.next - self.world.now()

    def call(self) -> None:
        now = self.world.time
        self.last = now
        self.next += self.period
        if self.next < now:
            self.next += (1 + (now - self.next - 1) // self.period) * self.period
        self.callback()


def grid(world: World, epoch: int | None, calls: list[int], period: int = PERIOD) -> Ros2GridTimer:
    node: Any = world
    return Ros2GridTimer(node, None, world.now, period / 1e9, epoch, lambda first, last: calls.append(first))


def test_the_first_call_comes_at_once_and_the_others_on_its_grid() -> None:
    world = World()
    calls: list[int] = []
    grid(world, None, calls)
    world.spin()
    assert len(calls) == 1
    assert 0 <= calls[0] - START < 10_000
    world.until(START + 10 * PERIOD)
    assert calls == [calls[0] + n * PERIOD for n in range(10)]


def test_a_given_grid_is_taken_up_at_its_next_slot() -> None:
    world = World()
    calls: list[int] = []
    epoch = START - 7 * PERIOD - 5_000_000
    grid(world, epoch, calls)
    world.until(START + 3 * PERIOD)
    assert calls == [epoch + n * PERIOD for n in (8, 9, 10)]


def test_a_grid_that_begins_later_is_taken_up_before() -> None:
    """A hand-over agrees on a future slot; the grid goes on in both directions from it."""
    world = World()
    calls: list[int] = []
    epoch = START + 10 * PERIOD + 3_000_000
    grid(world, epoch, calls)
    world.until(START + 2 * PERIOD)
    assert calls == [epoch - 10 * PERIOD, epoch - 9 * PERIOD]


def test_going_over_to_another_grid() -> None:
    world = World()
    calls: list[int] = []
    timer = grid(world, None, calls)
    world.until(START + 5 * PERIOD + 1_000_000)
    del calls[:]
    epoch = START + 7_000_000
    timer.regrid(epoch)
    world.until(START + 8 * PERIOD)
    assert calls == [epoch + n * PERIOD for n in (5, 6, 7)]


def test_a_late_call_is_given_the_slot_that_came_due_first_and_the_others_are_skipped() -> None:
    world = World()
    calls: list[int] = []
    grid(world, START, calls)
    world.until(START + 2 * PERIOD + 1_000)
    world.asleep_until(START + 5 * PERIOD + 9_000_000)
    world.until(START + 7 * PERIOD + 1_000)
    assert calls == [START + n * PERIOD for n in (1, 2, 3, 6, 7)]


def test_a_late_call_stands_for_the_slots_that_it_missed() -> None:
    world = World()
    calls: list[tuple[int, int]] = []
    node: Any = world
    Ros2GridTimer(node, None, world.now, PERIOD / 1e9, START, lambda first, last: calls.append((first, last)))
    world.until(START + PERIOD + 1_000)
    world.asleep_until(START + 4 * PERIOD + 9_000_000)
    world.until(START + 6 * PERIOD + 1_000)
    assert calls == [
        (START + first * PERIOD, START + last * PERIOD) for first, last in ((1, 1), (2, 4), (5, 5), (6, 6))
    ]


def test_the_callback_may_take_longer_than_a_period() -> None:
    world = World()
    slots: list[int] = []

    def slow(slot: int, last: int) -> None:
        slots.append(slot)
        world.time += PERIOD * 5 // 2 if len(slots) == 2 else 1_000_000

    node: Any = world
    Ros2GridTimer(node, None, world.now, PERIOD / 1e9, START, slow)
    world.until(START + 8 * PERIOD + 1_000)
    assert slots == [START + n * PERIOD for n in (1, 2, 3, 5, 6, 7, 8)]


def test_cancelling_and_going_over_within_a_callback() -> None:
    world = World()
    slots: list[int] = []

    def once(slot: int, last: int) -> None:
        slots.append(slot)
        if len(slots) == 2:
            timer.regrid(START + 5_000_000)
        if len(slots) == 4:
            timer.cancel()

    node: Any = world
    timer = Ros2GridTimer(node, None, world.now, PERIOD / 1e9, START, once)
    world.until(START + 9 * PERIOD)
    assert slots == [START + PERIOD, START + 2 * PERIOD, START + 2 * PERIOD + 5_000_000, START + 3 * PERIOD + 5_000_000]
    assert world.timers == []
    timer.cancel()


@pytest.mark.parametrize("epoch", [None, START + 7_000_000])
def test_there_is_no_call_before_the_clock_starts(epoch: int | None) -> None:
    world = World(now=0)
    calls: list[int] = []
    grid(world, epoch, calls)
    world.spin()
    assert calls == []
    world.asleep_until(START)
    world.until(START + PERIOD)
    first = START if epoch is None else epoch
    assert calls[0] - first in range(1_000)
    assert len(calls) in (1, 2)


def test_a_clock_that_is_set_back_is_followed_on_the_same_grid() -> None:
    world = World()
    calls: list[int] = []
    grid(world, START, calls)
    world.until(START + 3 * PERIOD + 5_000_000)
    del calls[:]
    back = START - 1000 * PERIOD + 3_000_000
    world.jump(back)
    world.until(back + 4 * PERIOD)
    assert len(calls) >= 3
    assert all((slot - START) % PERIOD == 0 for slot in calls)
    assert all(0 <= slot - back < 4 * PERIOD for slot in calls)
    assert calls == sorted(set(calls))


def test_a_system_clock_that_is_set_back_does_not_silence_the_timer() -> None:
    world = World()
    calls: list[int] = []
    timer = grid(world, START, calls)
    world.until(START + 3 * PERIOD + 5_000_000)
    del calls[:]
    back = START - 1000 * PERIOD + 3_000_000
    world.time = back
    world.until(back + 4 * PERIOD)
    assert calls == [], "rcl calls it when the clock is where it was"
    timer.follow_clock()
    timer.follow_clock()
    world.until(back + 8 * PERIOD)
    assert calls == [START + n * PERIOD for n in range(-995, -991)]
    timer.cancel()
    timer.follow_clock()
    assert not world.timers


def test_a_timer_that_is_late_keeps_the_slots_that_it_has_missed() -> None:
    """Where the clock seems to have been set back, and has not been."""
    world = World()
    calls: list[int] = []
    timer = grid(world, START, calls)
    world.until(START + 2 * PERIOD + 1_000)
    world.asleep_until(START + 4 * PERIOD + 9_000_000)
    timer.follow_clock()
    world.until(START + 5 * PERIOD + 1_000)
    assert calls == [START + n * PERIOD for n in (1, 2, 3, 5)]


def test_a_system_clock_that_is_set_back_is_noticed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    system = steady = START
    monkeypatch.setattr("time.time_ns", lambda: system)
    monkeypatch.setattr("time.monotonic_ns", lambda: steady)
    clock, noticed = SetBackWatch(), []
    for step, gone in (
        (1_000_000_000, 1_000_000_000),
        (999_500_000, 10**9),
        (-(10**9), 10**9),
        (10**9, 10**9),
        (5 * 10**9, 0),
    ):
        system, steady = system + step, steady + gone
        noticed.append(clock.was_set_back())
    assert noticed == [False, False, True, False, False]


@pytest.mark.parametrize("seed", range(30))
def test_no_slot_is_called_twice_nor_off_its_grid_whatever_the_machine_does(seed: int) -> None:
    chance = random.Random(seed)
    period = chance.choice([5_000_000, 20_000_000, 33_333_333])
    world = World()
    calls: list[int] = []
    timer = grid(world, START, calls, period)
    world.hiccup = lambda: chance.choice([0] * 30 + [60_000, 2_000_000, 9_000_000])  # preempted by others
    epoch = START
    for _ in range(200):
        before = len(calls)
        if chance.random() < 0.2:
            world.asleep_until(world.time + chance.randrange(4 * period))
        world.until(world.time + chance.randrange(3 * period))
        fresh = calls[before:]
        assert all((slot - epoch) % period == 0 for slot in fresh)
        assert fresh == sorted(set(fresh))
        assert all(slot <= world.time for slot in fresh)
        if chance.random() < 0.1:
            epoch = world.time + chance.randrange(-10 * period, 10 * period)
            timer.regrid(epoch)
    world.hiccup = lambda: 0
    world.until(world.time + 3 * period)  # left alone, it is on its grid again
    off = (world.timers[0].next - epoch) % period
    assert min(off, period - off) <= TOLERANCE
