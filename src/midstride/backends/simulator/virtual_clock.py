"""The simulator's clocks, which are the loop's and so jump with it where it is virtual; and timers on them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from functools import partial
from typing import Final

from midstride.node.clock_history import ClockHistory

# What the ROS clock reads at 0 of the steady one (ns): any time but 0, which would mean "no clock yet".
EPOCH: Final = 1_000_000_000_000_000_000
# How far apart the moments are at which a ROS clock that `/clock` drives is recorded (ns): between them it runs evenly.
CLOCK_INTERVAL: Final = 50_000_000
# How many processors the simulated machine has: the number of this one would make runs differ between machines.
PROCESSORS: Final = 2


class SimulatedClock:
    """A :class:`midstride.runtime.manager_clock.Clock`. It does not advance until the simulator runs on a loop.

    The ROS clock is the system's, until :meth:`drive` has ``/clock`` drive it.
    """

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._time: Callable[[], float] = float  # of the loop, once there is one
        self._zero = 0.0
        # The clocks are read several times at one moment: that of the loop, and what they read then (ns).
        self._at = math.nan
        self._steady = self._ros = 0
        self.driven = False
        self.timers: dict[SimulatedTimer, None] = {}  # in order: that of a set differs from run to run
        # Where `/clock` drives it: what it read at a moment of the steady clock (ns), and its speed since.
        self._since = self._base = 0
        self._speed = 1.0
        self._history = ClockHistory()
        self._recorded = 0  # up to when (steady ns)

    def follow(self, loop: asyncio.AbstractEventLoop) -> None:
        """Follow ``loop`` from now on, starting at 0."""
        if loop is not self._loop:
            self._loop, self._time, self._zero, self._at = loop, loop.time, loop.time(), math.nan

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        assert self._loop is not None, "the simulator has not been opened"
        return self._loop

    def steady(self) -> float:
        return self._time() - self._zero

    def steady_ns(self) -> int:
        if (at := self._time()) != self._at:
            self._read(at)
        return self._steady

    def system_now(self) -> int:
        return EPOCH + self.steady_ns()

    def ros_now(self) -> int:
        if (at := self._time()) != self._at:
            self._read(at)
        return self._ros

    def _read(self, at: float) -> None:
        self._at, self._steady = at, round((at - self._zero) * 1e9)
        self._ros = self._driven_to(self._steady) if self.driven else EPOCH + self._steady

    def _driven_to(self, steady: int) -> int:
        """The time to which ``/clock`` has driven the ROS clock at that moment of the steady one (ns)."""
        passed = steady - self._since
        return self._base + (passed if self._speed == 1.0 else round(passed * self._speed))

    def drive(self, speed: float, at: int | None = None) -> None:
        """Have ``/clock`` drive the ROS clock of every component, at ``speed`` from now on (0: it stands still).

        It continues at ``at`` (ns), by default at what it shows now.
        """
        now = self.ros_now() if at is None else at
        self._record()
        self.driven, self._base, self._since, self._speed = True, now, self.steady_ns(), speed
        self._recorded, self._at = self._since, math.nan
        self._history.add(self._since, now)
        for timer in list(self.timers):
            timer.clock_changed()

    @property
    def history(self) -> ClockHistory:
        """A moment for each ``CLOCK_INTERVAL`` in which ``/clock`` drove the ROS clock."""
        self._record()
        return self._history

    def _record(self) -> None:
        """Only now, since how it has run follows from its speed: a timer would be a third of all that happens."""
        if self.driven:
            for steady in range(self._recorded + CLOCK_INTERVAL, self.steady_ns() + 1, CLOCK_INTERVAL):
                self._history.add(steady, self._driven_to(steady))
                self._recorded = steady

    def loop_time(self, ros: int) -> float:
        """The loop's time at which the ROS clock reads ``ros``; infinite where it has stopped before that."""
        if not self.driven:
            return self._zero + (ros - EPOCH) / 1e9
        left = ros - self.ros_now()
        if left > 0 and self._speed == 0:
            return math.inf
        return self.loop.time() + max(0.0, left / 1e9 / (self._speed or 1.0))

    def processors(self) -> int:
        return PROCESSORS

    def idle(self) -> float:
        return 0.0  # that of this machine would make runs differ

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


class HostClock:
    """The clocks of a host: those of ``base``, ``ahead`` by so much (s), and fast by ``drift`` (s for each s).

    The steady one is as fast, and is read on its own host alone. What ``/clock`` drives is the same on every host; the
    two are not to be combined, since the history of ``/clock`` is kept on the steady clock of ``base``.
    """

    def __init__(self, base: SimulatedClock, ahead: float = 0.0, drift: float = 0.0) -> None:
        self._base = base
        self._ahead, self._drift = round(ahead * 1e9), drift

    @property
    def driven(self) -> bool:
        return self._base.driven

    @property
    def history(self) -> ClockHistory:
        return self._base.history

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        return self._base.loop

    @property
    def timers(self) -> dict[SimulatedTimer, None]:
        return self._base.timers

    def steady_ns(self) -> int:
        steady = self._base.steady_ns()
        return steady + round(steady * self._drift)

    def system_now(self) -> int:
        return EPOCH + self._ahead + self.steady_ns()

    def ros_now(self) -> int:
        return self._base.ros_now() if self._base.driven else self.system_now()

    def loop_time(self, ros: int) -> float:
        """The time on the loop's clock at which the ROS clock here reads ``ros``."""
        if self._base.driven:
            return self._base.loop_time(ros)
        return self._base.loop_time(EPOCH + round((ros - EPOCH - self._ahead) / (1 + self._drift)))


class SimulatedTimer:
    """Implements :class:`midstride.node.component_host.Timer`: skips slots while the data thread is busy.

    ``period`` and ``epoch`` in ns.
    """

    def __init__(
        self,
        clock: SimulatedClock | HostClock,
        enqueue: Callable[[Callable[[], None]], None],
        period: int,
        epoch: int | None,
        callback: Callable[[int, int], None],
    ) -> None:
        self._clock = clock
        self._enqueue = enqueue
        self._period = period
        self._callback = callback
        self._cancelled = False
        self._handle: asyncio.TimerHandle | None = None
        self._due = clock.ros_now() if epoch is None else self._next(epoch, clock.ros_now())
        clock.timers[self] = None
        self._arm()

    def regrid(self, epoch: int) -> None:
        self._due = self._next(epoch, self._clock.ros_now())
        self._arm()

    def cancel(self) -> None:
        self._cancelled = True
        self._clock.timers.pop(self, None)
        if self._handle is not None:
            self._handle.cancel()

    def clock_changed(self) -> None:
        """The clock runs at another speed; where it jumped back, as rcl does: the next slot comes within a period."""
        now = self._clock.ros_now()
        if self._due - now > self._period:
            self._due = self._next(self._due, now)
        self._arm()

    def _next(self, epoch: int, after: int) -> int:
        """The first slot of the grid later than ``after``."""
        return epoch + ((after - epoch) // self._period + 1) * self._period

    def _arm(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        if math.isfinite(at := self._clock.loop_time(self._due)):
            self._handle = self._clock.loop.call_at(at, self._enqueue, partial(self._call, self._due))

    def _call(self, slot: int) -> None:
        if self._cancelled or slot != self._due:  # cancelled, or put on another grid, while it was queued
            return
        self._due = max(slot + self._period, self._next(slot, self._clock.ros_now() - 1))
        self._arm()
        self._callback(slot, self._due - self._period)
