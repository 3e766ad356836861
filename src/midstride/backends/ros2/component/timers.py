"""A timer on a grid that is agreed beforehand: slot ``n`` is at ``epoch + n * period`` on the ROS clock.

rcl's timers know no phase. Setting the period to what remains until a slot, resetting, and setting
the period back puts one there; from then on rcl itself adds whole periods, and skips those a late
call has missed. What rcl is about to do is read back after each call: that shows which slot the next
call belongs to, and whether the timer has left its grid (a clock that jumped back, a preemption in
the middle of setting it), which is then corrected. rcl learns of a jump from `/clock` alone: where
the system's clock is set back, it would not call before that is where it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

# A timer further off its grid than this (ns) is put back on it.
TOLERANCE: Final = 200_000
# Two readings of clocks that lie further apart than this (ns) are not of one moment: they are taken again.
_ONE_MOMENT: Final = 50_000
_ATTEMPTS: Final = 5
# The system's clock has been set back if it has fallen behind the steady one by more than this (ns); it is slewed by
# less.
_SET_BACK: Final = 5_000_000


class SetBackWatch:
    """Notices that the system's clock has been set back since it was last asked."""

    def __init__(self) -> None:
        self._ahead = time.time_ns() - time.monotonic_ns()

    def was_set_back(self) -> bool:
        """Also if this thread was preempted for long while it was looking: of no consequence to a timer."""
        before, self._ahead = self._ahead, time.time_ns() - time.monotonic_ns()
        return before - self._ahead > _SET_BACK


class Ros2GridTimer:
    """See :class:`midstride.node.component_host.Timer`. Everything here runs on the data side."""

    def __init__(
        self,
        node: Any,
        group: Any,
        now: Callable[[], int],
        period: float,
        epoch: int | None,
        callback: Callable[[int, int], None],
    ) -> None:
        self._node = node
        self._now = now
        self._period = max(1, round(period * 1e9))
        self._epoch = epoch
        self._callback = callback
        self._due = 0
        self._waiting = False  # for the clock to start: until then there is no grid to be on
        self._timer: Any = node.create_timer(period, self._fire, callback_group=group)
        self._cancelled = False
        if epoch is not None:
            self.regrid(epoch)
        elif now() == 0:
            self._waiting = True
        else:
            self._epoch = self._aim(0)
            self._due = self._epoch

    def regrid(self, epoch: int) -> None:
        self._epoch = epoch
        now = self._now()
        self._waiting = now == 0
        if self._waiting:
            return
        for _ in range(_ATTEMPTS):
            slot = now + self._period - (now - epoch) % self._period
            if 0 <= self._aim(slot - now) - slot <= TOLERANCE:
                break
            now = self._now()
        self._due = slot

    def follow_clock(self) -> None:
        """The clock has been set back, and rcl may not know."""
        if not self._cancelled and self._epoch is not None and self._next() - self._now() > self._period + TOLERANCE:
            self.regrid(self._epoch)

    def cancel(self) -> None:
        if not self._cancelled:
            self._cancelled = True
            self._timer.cancel()
            self._node.destroy_timer(self._timer)

    def _aim(self, remaining: int) -> int:
        """Have rcl call in ``remaining`` ns; when (ns) it now says it will."""
        timer = self._timer
        timer.timer_period_ns = remaining
        timer.reset()
        timer.timer_period_ns = self._period
        return self._next()

    def _next(self) -> int:
        """The time of rcl's next call; in the past if that is overdue."""
        for _ in range(_ATTEMPTS):
            now = self._now()
            remaining = self._timer.time_until_next_call()
            if self._now() - now < _ONE_MOMENT:
                break
        return now + int(remaining or 0)

    def _fire(self) -> None:
        now, epoch = self._now(), self._epoch
        if self._cancelled or now == 0:
            return
        if self._waiting or epoch is None:  # no longer: the clock has just started
            self.regrid(now if epoch is None else epoch)
            if epoch is None:
                self._callback(now, now)
            return
        if self._due - now > TOLERANCE:  # the clock has jumped back
            self._due = epoch + (now - epoch) // self._period * self._period
        last = self._due
        if now >= last + self._period:  # late: rcl alone knows which slots it skips
            last = max(last, self._nearest(self._next()) - self._period)
        self._callback(self._due, last)
        self._follow()

    def _nearest(self, moment: int) -> int:
        """The slot nearest to ``moment``."""
        assert self._epoch is not None
        return self._epoch + (moment - self._epoch + self._period // 2) // self._period * self._period

    def _follow(self) -> None:
        """Learn which slot comes next; put the timer back on its grid where rcl has left it."""
        if self._cancelled or self._epoch is None:  # by the callback
            return
        upcoming = self._next()
        self._due = self._nearest(upcoming)
        if abs(upcoming - self._due) > TOLERANCE:
            self.regrid(self._epoch)
