"""Timers on an agreed grid: slot ``n`` is at ``epoch + n * period`` on the ROS clock."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

import rospy

from midstride.backends.ros1.data_thread import DataThread
from midstride.node.clock_history import ClockHistory

# A clock that was set back may wake a timer before its slot: if by more than this (ns), it sleeps again.
_EARLY = 200_000


class RosClock:
    """The ROS clock: the system's, or the one on ``/clock`` where ``/use_sim_time`` is set."""

    def __init__(self, data: DataThread) -> None:
        self.data = data
        self.simulated = not rospy.rostime.is_wallclock()
        self.now: Callable[[], int] = time.time_ns
        self.history = ClockHistory()
        self._waiting: dict[object, tuple[int, Callable[[], None]]] = {}
        if self.simulated:
            self.now = lambda: int(rospy.get_rostime().to_nsec())
            from rosgraph_msgs.msg import Clock

            rospy.Subscriber("/clock", Clock, lambda message: data.post(self._tick), queue_size=1)

    def call_at(self, key: object, when: int, function: Callable[[], None]) -> Callable[[], object]:
        """Call ``function`` on the data thread at ``when`` (ns); returns a function that cancels it."""
        if not self.simulated:
            loop = self.data.loop
            return loop.call_at(loop.time() + (when - self.now()) / 1e9, function).cancel
        self._waiting[key] = (when, function)
        if 0 < self.now() >= when:
            self.data.post(self._tick)
        return lambda: self._waiting.pop(key, None)

    def _tick(self) -> None:
        now = self.now()
        if now:
            self.history.add(time.monotonic_ns(), now)
        for key, (when, function) in sorted(self._waiting.items(), key=lambda item: item[1][0]):
            if 0 < now >= when and self._waiting.pop(key, None) is not None:
                function()

    def pause(self, seconds: float) -> Awaitable[None]:
        """To be awaited on the data thread."""
        if not self.simulated:
            return asyncio.sleep(seconds)
        over = self.data.loop.create_future()
        self.call_at(over, self.now() + int(seconds * 1e9), lambda: None if over.done() else over.set_result(None))
        return over


class Ros1GridTimer:
    """See :class:`midstride.node.component_host.Timer`. Everything here runs on the data thread."""

    def __init__(self, clock: RosClock, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> None:
        self._clock = clock
        self._period = max(1, round(period * 1e9))
        self._epoch = epoch
        self._callback = callback
        self._cancelled = False
        self._take_back: Callable[[], object] = lambda: None
        self._due = 0
        if epoch is not None:
            self.regrid(epoch)
        else:
            self._aim(clock.now())

    def regrid(self, epoch: int) -> None:
        self._epoch = epoch
        now = self._clock.now()
        self._aim(self._after(now) if now else 0)  # 0: the clock has not begun, and the next slot is unknown

    def cancel(self) -> None:
        self._cancelled = True
        self._take_back()

    def _after(self, moment: int) -> int:
        """The first slot after ``moment``."""
        assert self._epoch is not None
        return moment + self._period - (moment - self._epoch) % self._period

    def _aim(self, due: int) -> None:
        self._take_back()
        self._due = due
        self._take_back = self._clock.call_at(self, due, self._fire)

    def _fire(self) -> None:
        if self._cancelled:
            return
        now, due = self._clock.now(), self._due
        if self._epoch is None:  # the first call of all: the grid begins with it
            self._epoch = due = now
        elif due == 0 or now < due - _EARLY:
            self._aim(self._after(now))
            return
        self._callback(due, max(due, self._after(now) - self._period))
        if self._due <= max(now, due) and not self._cancelled:  # else the callback has set it anew or ended it
            self._aim(self._after(max(self._clock.now(), due)))
