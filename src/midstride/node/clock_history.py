"""The history of the ROS clock against the steady clock, where ``/clock`` drives it.

A simulation may run slower or faster than real time, stand still, or start again. What is measured is measured on its
clock; a time-out, which must end even if that clock does not move, is on the steady clock and is stretched by the
speed found here (docs/protocols/clocks.md).
"""

from __future__ import annotations

from collections import deque
from typing import Final

# How many moments are kept, and how far apart they are at least (ns): the last two minutes or more.
KEPT: Final = 12_000
SPACING: Final = 10_000_000
# The speed is that of the last second, and is not known before so much has gone by (ns).
SPEED_OVER: Final = 1_000_000_000
SPEED_AFTER: Final = 100_000_000
# A clock that has not moved for so long stands still (s).
STILL: Final = 2.0
# How many moments the speed needs at most: those of the last second, and the ends of pauses and jumps among them.
RECENT: Final = 2 * SPEED_OVER // SPACING

Moment = tuple[int, int]  # steady and ROS time, ns


class ClockHistory:
    """The moments at which ``/clock`` moved. The data thread adds them; any thread reads."""

    def __init__(self) -> None:
        self._kept: deque[Moment] = deque(maxlen=KEPT)
        self._recent: deque[Moment] = deque(maxlen=RECENT)  # the latest of them
        self._last: Moment | None = None

    def add(self, steady: int, ros: int) -> None:
        """At ``steady``, the clock was set to ``ros``. Of moments that are close together, few are kept."""
        moment, last = (steady, ros), self._last
        if last is not None and last[1] == ros:
            return
        if last is not None and (steady - last[0] >= SPACING or ros < last[1]) and last != self._kept[-1]:
            self._keep(last)  # a pause, or a jump back, begins here
        if last is None or steady - self._kept[-1][0] >= SPACING or ros < last[1]:
            self._keep(moment)
        self._last = moment

    def _keep(self, moment: Moment) -> None:
        self._kept.append(moment)
        self._recent.append(moment)

    def clear(self) -> None:
        """Another clock drives the ROS clock from now on."""
        self._last = None
        self._kept.clear()
        self._recent.clear()

    def moments(self) -> list[Moment]:
        last = self._last
        kept = list(self._kept)
        return kept if last is None or kept[-1:] == [last] else [*kept, last]

    def still_for(self, steady: int) -> float:
        """The time for which it has not moved (s); 0 before it has moved at all."""
        last = self._last
        return 0.0 if last is None else (steady - last[0]) / 1e9

    def speed(self, steady: int) -> float:
        """Seconds of the clock per second of the steady one; 0 while it stands still, or nothing is known."""
        last = self._last
        if last is None or self.still_for(steady) > STILL:
            return 0.0
        first = last
        for moment in reversed(list(self._recent)):
            if moment[1] > first[1] or last[0] - first[0] >= SPEED_OVER:
                break  # it jumped back after that moment, or that is far enough back
            first = moment
        elapsed = last[0] - first[0]
        return (last[1] - first[1]) / elapsed if elapsed >= SPEED_AFTER else 0.0
