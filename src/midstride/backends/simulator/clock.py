"""The simulator's two clocks: both are the loop's, so they jump with it where it is virtual."""

from __future__ import annotations

import asyncio
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
