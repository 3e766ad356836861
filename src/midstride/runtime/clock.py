"""Time is owned: production code is handed a clock, tests hand in a virtual one."""

from __future__ import annotations

import asyncio
import time
from typing import Protocol


class Clock(Protocol):
    """The steady clock of the manager: seconds from an arbitrary start, and sleeping on it."""

    def steady(self) -> float: ...

    def ros_now(self) -> int:
        """The ROS clock, ns."""
        ...

    async def sleep(self, seconds: float) -> None: ...


class SystemClock:
    """The real one."""

    def steady(self) -> float:
        return time.monotonic()

    def ros_now(self) -> int:
        return time.time_ns()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
