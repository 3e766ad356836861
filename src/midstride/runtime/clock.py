"""The manager's clock: that of the operating system in production, a virtual one in tests."""

from __future__ import annotations

import asyncio
import os
import time
from typing import Protocol


class Clock(Protocol):
    """The clock of the manager."""

    def steady(self) -> float:
        """Monotonic time in seconds, from an arbitrary start."""

    def ros_now(self) -> int:
        """ROS time in nanoseconds."""

    def processors(self) -> int:
        """How many processors the components run on."""
        ...

    def idle(self) -> float:
        """How long the processors have been idle, in total (s)."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Sleep on the monotonic clock."""


class SystemClock:
    """The clocks of the operating system."""

    def steady(self) -> float:
        return time.monotonic()

    def ros_now(self) -> int:
        return time.time_ns()

    def processors(self) -> int:
        return len(os.sched_getaffinity(0))

    def idle(self) -> float:
        with open("/proc/stat", encoding="ascii") as file:
            return int(file.readline().split()[4]) / os.sysconf("SC_CLK_TCK")

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
