"""The judgement whether an output keeps the rate that it promises (docs/protocols/probation.md).

The rate is that over a sliding window, and no pause may be long: neither a burst before a stall nor one after it makes
up for the stall. What counts as kept leaves room for jitter, and what counts as broken leaves more: between the two
nothing is concluded.
"""

from __future__ import annotations

import itertools
from collections import deque
from typing import Final

# Kept: so much of the rate, less one message, and no pause longer than so many periods, nor than one and so long (s).
KEPT_SHARE: Final = 0.9
KEPT_PERIODS: Final = 3.0
KEPT_JITTER: Final = 0.1
# Broken: less than so much of the rate, or a pause longer than so many periods, and at least so long (s).
BROKEN_SHARE: Final = 0.8
BROKEN_PERIODS: Final = 10.0
BROKEN_PAUSE: Final = 1.0


class RateWatch:
    """``rate`` in Hz, ``window`` in seconds, longer than some periods; ``now``, here and below, in ns of one clock."""

    def __init__(self, rate: float, window: float, now: int) -> None:
        self._promised = rate
        self._window = int(window * 1e9)
        self._begun = self._now = now
        self._writes: deque[tuple[int, int]] = deque([(now, 0)])  # when, and how many had been written by then

    def see(self, written: int, now: int) -> None:
        """``written`` messages in all by now, since the watch began."""
        if now < self._now:  # the clock was set back
            self._begun = now
            self._writes = deque([(now, written)])
        self._now = now
        if written != self._writes[-1][1]:
            self._writes.append((now, written))
        while len(self._writes) > 1 and self._writes[1][0] <= now - self._window:
            self._writes.popleft()

    @property
    def complete(self) -> bool:
        """Return whether a whole window has passed."""
        return self._now - self._begun >= self._window

    @property
    def rate(self) -> float:
        """In Hz, over the last window."""
        seconds = (min(self._window, self._now - self._begun)) / 1e9
        return (self._writes[-1][1] - self._writes[0][1]) / seconds if seconds else 0.0

    @property
    def pause(self) -> float:
        """The longest time (s) without a message that ends in the last window, or has not ended yet."""
        times = [*(at for at, _ in self._writes), self._now]
        return max(later - earlier for earlier, later in itertools.pairwise(times)) / 1e9

    @property
    def kept(self) -> bool:
        promised, window = self._promised, self._window / 1e9
        enough = self.rate * window >= KEPT_SHARE * promised * window - 1
        return self.complete and enough and self.pause <= max(KEPT_PERIODS / promised, 1 / promised + KEPT_JITTER)

    @property
    def broken(self) -> bool:
        if not self._promised:
            return False
        if self.pause > max(BROKEN_PERIODS / self._promised, BROKEN_PAUSE):
            return True
        window = self._window / 1e9
        return self.complete and self.rate * window < BROKEN_SHARE * self._promised * window - 1
