"""The simulator's two clocks, which are the loop's and so jump with it where it is virtual; and timers on them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Final

# What the ROS clock reads at 0 of the steady one (ns): any time but 0, which would mean "no clock yet".
EPOCH: Final = 1_000_000_000_000_000_000


class SimulatedClock:
    """A :class:`midstride.runtime.clock.Clock`. It does not advance until the simulator runs on a loop."""

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._zero = 0.0

    def follow(self, loop: asyncio.AbstractEventLoop) -> None:
        """Follow ``loop`` from now on, starting at 0."""
        if loop is not self._loop:
            self._loop, self._zero = loop, loop.time()

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        assert self._loop is not None, "the simulator has not been opened"
        return self._loop

    def steady(self) -> float:
        return 0.0 if self._loop is None else self._loop.time() - self._zero

    def steady_ns(self) -> int:
        return round(self.steady() * 1e9)

    def ros_now(self) -> int:
        return EPOCH + self.steady_ns()

    def loop_time(self, ros: int) -> float:
        """When on the loop's clock the ROS clock reads ``ros``."""
        return self._zero + (ros - EPOCH) / 1e9

    def idle(self) -> float:
        return 0.0  # that of this machine would make runs differ

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


class SimulatedTimer:
    """Implements :class:`midstride.node.host.Timer`: skips slots while the data thread is busy.

    ``period`` and ``epoch`` in ns.
    """

    def __init__(
        self,
        clock: SimulatedClock,
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
        self._arm()

    def regrid(self, epoch: int) -> None:
        self._due = self._next(epoch, self._clock.ros_now())
        self._arm()

    def cancel(self) -> None:
        self._cancelled = True
        if self._handle is not None:
            self._handle.cancel()

    def _next(self, epoch: int, after: int) -> int:
        """The first slot of the grid later than ``after``."""
        return epoch + ((after - epoch) // self._period + 1) * self._period

    def _arm(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
        call = partial(self._call, self._due)
        self._handle = self._clock.loop.call_at(self._clock.loop_time(self._due), self._enqueue, call)

    def _call(self, slot: int) -> None:
        if self._cancelled or slot != self._due:  # cancelled, or put on another grid, while it waited its turn
            return
        self._due = max(slot + self._period, self._next(slot, self._clock.ros_now() - 1))
        self._arm()
        self._callback(slot, self._due - self._period)
