"""The shortfall of a stream of messages from its promised rate: the rule that tells jitter from breakage.

docs/protocols/reflex.md. Silence breaks a stream after a stated number of periods. A stream that is
merely slow has more time, since a busy machine may be the cause: of a share of the promised messages, what is missing
adds up, each message reduces it, and nothing is saved up. So a stream that keeps this share never breaks.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from midstride.model.wording import counted
from midstride.node.component_host import Host

# The share of the promised messages that is due.
SHARE: Final = 0.4
# How much of that may be missing of a slow stream: as much as in so many times the silence that is tolerated.
SLOW: Final = 2.0
# How many missed messages are tolerated where nothing is stated: as many as a hand-over without a manager may miss.
TOLERATED: Final = 10
# The least silence that is tolerated where nothing is stated (s): on an overloaded machine, nodes at 200 Hz wrote
# nothing for a second. While a plan replaces a publisher, it is that in any case: a transfer of state takes up to 2 s.
LONG_FLOOR: Final = 5.0
# The same before the first message in a mode, where a tolerance is stated (s).
FLOOR: Final = 1.0
# The most that counts at once (s): a simulation may jump forward.
_LARGEST_STEP: Final = 0.5
# Over how many laps the speed of ``/clock`` is measured.
_LAPS: Final = 10


def tolerated_periods(rate: float, missed: int | None, floor: float) -> float:
    """For how many periods a stream of ``rate`` (Hz) may be silent, at least ``floor`` seconds."""
    return max((TOLERATED if missed is None else missed) + 1, floor * rate)


class Shortfall:
    """Of one stream, whose messages have been counted up to ``count``. ``fresh``: none has come since."""

    def __init__(self, count: int) -> None:
        self.restart(count)

    def restart(self, count: int) -> None:
        self.count = count
        self.fresh = True
        self.silent = 0.0  # for how many periods none has come
        self._clear()

    def _clear(self) -> None:
        self._lacking = 0.0
        # Since nothing was lacking: how many periods have gone by, and how many messages have come.
        self.periods = 0.0
        self.came = 0

    def advance(self, periods: float, count: int) -> None:
        """``periods`` have gone by, and ``count`` messages have come in all."""
        came, self.count = count - self.count, count
        if came < 0:  # another attachment
            self.restart(count)
            return
        self.fresh = self.fresh and not came
        self.silent = 0.0 if came else self.silent + periods
        self._lacking += SHARE * periods - came
        self.periods += periods
        self.came += came
        if self._lacking <= 0:
            self._clear()

    @property
    def in_order(self) -> bool:
        """Return whether a message has come since the last call of this, and nothing is lacking."""
        return not self.silent and not self._lacking

    def halve(self) -> None:
        """Part of it was not the stream's fault."""
        self._lacking /= 2
        self.silent /= 2

    def words(self, rate: float) -> tuple[str, float]:
        """The amount that has come in so many seconds, in words: nothing since the last message, or too little."""
        if 2 * self.silent >= self.periods:
            return "nothing", self.silent / rate
        return counted(self.came, "message"), self.periods / rate

    def exceeds(self, periods: float, slow: bool = True) -> bool:
        """Return whether the stream has been silent for more than ``periods`` or, with ``slow``, too slow for
        longer.
        """
        return self.silent > periods or (slow and self._lacking > SLOW * SHARE * periods)


class Stopwatch:
    """The time in which a component could have received and written what was due.

    On the ROS clock, so that nothing is due while ``/clock`` stands still. The time in which this process did not run
    is its own fault, not that of its publishers, and hardly counts.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._steady = host.steady()
        self._ros = host.now()
        # For how long still nothing is due, after the process has been stopped (s).
        self.grace = 0.0
        # How much of the time gone by has not been counted: ``/clock`` may move in large steps (s).
        self._room = 0.0
        # The last laps, on the steady and on the ROS clock (ns).
        self._laps: deque[tuple[int, int]] = deque(maxlen=_LAPS)
        # The seconds of its clock in a second of the steady one, at least 1; a jump of ``/clock`` is no speed.
        self.speed = 1.0

    def _measured_speed(self) -> float:
        if not self._host.simulated_time or len(self._laps) < _LAPS:
            return 1.0
        longest, largest = 0, -1  # the lap with the largest step of the ROS clock
        steady = ros = 0
        for gone, moved in self._laps:
            steady += gone
            ros += moved
            if moved > largest:
                longest, largest = gone, moved
        return max(1.0, (ros - largest) / max(1, steady - longest))

    def lap(self, expected: float) -> float:
        """The seconds since the last lap; if that took more than twice the ``expected`` ones, no more than these."""
        steady, ros = self._host.steady(), self._host.now()
        lap = (steady - self._steady, max(0, ros - self._ros))
        self._steady, self._ros = steady, ros
        self._laps.append(lap)
        gone, moved = lap[0] / 1e9, lap[1] / 1e9
        self.speed = self._measured_speed()
        # What was sent to a process that was stopped may have to be sent again, or its peers have to find it again.
        self.grace = LONG_FLOOR if gone >= FLOOR else max(0.0, self.grace - gone)
        self._room = min(_LARGEST_STEP, self._room + min(gone, 2 * expected))
        seconds = min(moved if self._host.simulated_time else gone, self._room * self.speed)
        self._room -= seconds / self.speed
        return seconds
