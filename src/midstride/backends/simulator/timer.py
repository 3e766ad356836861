"""Timers on a time grid: exact in virtual time, skipping and not bursting when the data thread is busy."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from midstride.backends.simulator.clock import SimulatedClock


class SimulatedTimer:
    """Implements :class:`midstride.node.host.Timer`. ``period`` and ``epoch`` in ns."""

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
        self._handle = self._clock.loop.call_at(self._clock.loop_time(self._due), self._fire, self._due)

    def _fire(self, slot: int) -> None:
        self._enqueue(lambda: self._call(slot))

    def _call(self, slot: int) -> None:
        if self._cancelled or slot != self._due:  # cancelled, or put on another grid, while it waited its turn
            return
        self._due = max(slot + self._period, self._next(slot, self._clock.ros_now() - 1))
        self._arm()
        self._callback(slot, self._due - self._period)
