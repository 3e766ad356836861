"""The manager's clock: that of the operating system in production, a virtual one in tests."""

from __future__ import annotations

import asyncio
import time
from typing import Protocol


class Clock(Protocol):
    """The clock of the manager."""

    def steady(self) -> float:
        """Monotonic time in seconds, from an arbitrary start."""

    def ros_now(self) -> int:
        """ROS time in nanoseconds."""

    async def sleep(self, seconds: float) -> None:
        """Sleep on the monotonic clock."""


class SystemClock:
    """The clocks of the operating system."""

    def steady(self) -> float:
        return time.monotonic()

    def ros_now(self) -> int:
        return time.time_ns()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
