"""The manager's clock: that of the operating system in production, a virtual one in tests."""

from __future__ import annotations

import asyncio
import os
import time
from itertools import takewhile
from typing import Final, Protocol

STAT: Final = "/proc/stat"


class Clock(Protocol):
    """The clock of the manager."""

    def steady(self) -> float:
        """Monotonic time in seconds, from an arbitrary start."""

    def ros_now(self) -> int:
        """ROS time in nanoseconds."""

    def processors(self) -> int:
        """The number of processors on which the components run."""
        ...

    def idle(self) -> float:
        """The time for which the processors have been idle, in total (s)."""
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
        own = {f"cpu{number}" for number in os.sched_getaffinity(0)}
        with open(STAT, encoding="ascii") as file:
            every = [line.split() for line in takewhile(lambda line: line.startswith("cpu"), file)]
        # A container may number them from 0, whatever their numbers are: then the first line, of all that it is shown.
        found = [words for words in every if words[0] in own] or every[:1]
        return sum(int(words[4]) for words in found) / os.sysconf("SC_CLK_TCK")

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
