"""The moments at which the live view is built, and the alarms that cause it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Final

from midstride.runtime.manager_clock import Clock

# How long after a difference the view is built (s): what changes together is sent together.
TOGETHER: Final = 0.005
# How often it is built at most (s).
SOON: Final = 0.05
# How often at most measurements, values of parameters and reasons of modes are refreshed while there are clients
# (s); and those of how many components in a second, so that a large system costs no more to watch.
MEASURED_EVERY: Final = 0.5
REFRESHED: Final = 500
# How often it is looked for what no report shows: components and ports that are silent (s).
LOOK: Final = 1.0


def measurements_interval(components: int) -> float:
    """The interval at which measurements are refreshed in a system of so many components (s)."""
    return max(MEASURED_EVERY, components / REFRESHED)


class Alarm:
    """Calls back once, at the earliest of the times that it is set to, between :meth:`start` and :meth:`stop`."""

    def __init__(self, clock: Clock, call: Callable[[], object]) -> None:
        self._clock = clock
        self._call = call
        self._timer: asyncio.TimerHandle | None = None
        self._due = math.inf
        self._started = False

    def start(self) -> None:
        self._started = True

    def stop(self) -> None:
        self._started = False
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self._due = None, math.inf

    @property
    def is_set(self) -> bool:
        return self._timer is not None

    def at(self, due: float) -> None:
        """At ``due`` (steady s), or earlier if it is set to an earlier time. Needs the running loop."""
        if not self._started or due >= self._due:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._due = due
        delay = max(0.0, due - self._clock.steady())
        self._timer = asyncio.get_running_loop().call_later(delay, self._ring)

    def _ring(self) -> None:
        self._timer, self._due = None, math.inf
        self._call()
