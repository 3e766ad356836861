"""How `/clock` moves, as components with an agent of Midstride inside report.

Neither the page of the gates nor the manager has times on it. So a node without Midstride's API that follows it is
judged by its silence only where such a component does, too.
"""

from __future__ import annotations

import time
from typing import Final

from midstride.foreign.reported_writes import FRESH
from midstride.wire.state import ComponentState

# How long it may have stood still before that is reported (s): a component waits for 2 s, and reports twice a second.
UNNOTICED: Final = 3.0


class ReportedClock:
    """``speed``: the seconds on `/clock` in each second; 0 where it stands still, or that is not known."""

    def __init__(self) -> None:
        self._speed = 0.0
        self._at = self._since = 0.0  # of the last report, and of the first since which it moves (steady s)

    def note(self, state: ComponentState) -> None:
        """A component with an agent inside has reported this."""
        if not state.simulated_time:
            return
        now = time.monotonic()
        if not self.speed or not state.clock_speed:
            self._since = now
        self._speed, self._at = state.clock_speed, now

    @property
    def speed(self) -> float:
        return self._speed if time.monotonic() - self._at < FRESH else 0.0

    def due(self, seconds: float) -> float | None:
        """For how long, of the last ``seconds``, something was due on it, at least; None where that is not known.

        As for components with an agent, that is longer where it is slow, and no less where it is fast.
        """
        speed, moving = self.speed, time.monotonic() - self._since
        return max(0.0, min(seconds, moving) - UNNOTICED) * min(speed, 1.0) if speed else None
