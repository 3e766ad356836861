"""The times at which the messages of one attachment came or went, and what follows: rate, age and jitter.

All of it is on the node's ROS clock, so it is also right where a simulation runs slower than real time
(docs/protocols/measurement.md). The data path appends one time per message; everything else is computed on demand.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Final

from midstride.wire.state import Measured

# The window over which a rate is measured: so many of its periods, but at least so long; without a declared rate, the
# longer one (s).
WINDOW_PERIODS: Final = 10
WINDOW: Final = 1.0
WINDOW_WITHOUT_RATE: Final = 10.0
# How many times are kept. Above 1 kHz the window is shorter than its stated length: that of the last 1,024 messages.
KEPT: Final = 1024


def window_of(rate: float | None) -> float:
    """The length of the window for a declared rate (s): ten periods, at least 1 s; 10 s where none is declared."""
    return WINDOW_WITHOUT_RATE if rate is None else max(WINDOW, WINDOW_PERIODS / rate)


class MessageTimes:
    """The times of the last messages of one attachment (ns). Written on the data thread, read on any.

    The measurement begins when it is created, and afresh where the clock jumps back. Messages before the clock runs
    (time 0) do not count.
    """

    __slots__ = ("_append", "_begun", "_now", "_times")

    def __init__(self, now: Callable[[], int]) -> None:
        self._now = now
        self._begun = now()
        self._times: deque[int] = deque(maxlen=KEPT)
        self._append = self._times.append

    def restart(self) -> None:
        """Measure from now on: something else is declared. On the data thread."""
        self._begun = self._now()
        self._times.clear()

    def mark(self) -> int:
        """A message comes or goes now; returns the time (ns)."""
        now = self._now()
        self._append(now)
        return now

    def last(self) -> int | None:
        """The time at which the last message came or went (ns); None if there was none."""
        times = self._times
        return times[-1] if times else None

    def age(self) -> float | None:
        """Seconds since the last message; None if there was none."""
        return _age(self.last() or 0, self._now())

    def measured(self, window: float) -> Measured:
        """The measurements of the last ``window`` seconds, or since the first message that is kept.

        A gap between messages that began before the window counts in proportion. The time since the last message
        counts as a gap once it is longer than the mean gap. So the rate of a regular publisher does not depend on the
        moment at which it is measured, and that of one that stops falls to 0 within the window.
        """
        times = list(self._times)
        now = self._now()  # read after the copy: a later time in the copy shows a clock that has jumped back
        if max([self._begun, *times[-1:]]) > now:
            self._times.clear()
            self._begun, times = now, []
        self._begun = self._begun or now
        length, age = round(window * 1e9), _age(times[-1] if times else 0, now)
        if len(times) == KEPT:
            length = min(length, now - times[0])
        window = length / 1e9
        if age is None:
            waited = now - self._begun
            rate = 0.0 if waited >= length else None
            return Measured(window=window, covered=min(waited, length) / 1e9, rate=rate)
        open_gap = now - times[-1]
        if open_gap >= length:
            return Measured(window=window, covered=window, rate=0.0, age=age, longest=age)
        gaps = _gaps(times, now - length)
        known = sum(gaps) + open_gap
        covered = min(max(known, now - self._begun), length) / 1e9
        if not gaps:
            rate = 1 / window if covered == window else None
            return Measured(window=window, covered=covered, rate=rate, age=age)
        mean, outside = sum(gaps) / len(gaps), max(0, known - length)
        count: float = len(gaps) - (outside / gaps[-1] if outside else 0)
        span = known - open_gap - outside
        if open_gap * count > span:
            count, span = count + 1, span + open_gap
        return Measured(
            window=window,
            covered=covered,
            rate=count * 1e9 / span if span else None,
            age=age,
            jitter=math.sqrt(sum([(gap - mean) ** 2 for gap in gaps]) / len(gaps)) / 1e9,
            longest=max(open_gap, *gaps) / 1e9,
        )


def _age(last: int, now: int) -> float | None:
    return (now - last) / 1e9 if 0 < last <= now else None


def _gaps(times: list[int], start: int) -> list[int]:
    """The times between messages that end after ``start``, the latest first; back to where the clock jumped back."""
    found: list[int] = []
    for later, earlier in pairwise(reversed(times)):
        if later <= start or not 0 < earlier <= later:
            break
        found.append(later - earlier)
    return found
