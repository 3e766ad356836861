"""The times that the servers of a component take to answer, by when requests came and were answered.

docs/protocols/foreign.md says what is made of it.

A request counts from its arrival at the middleware, where that is known; one that was held, since another instance
answered, from when it is handled here. The clock is the slower one of the steady and the ROS clock: nothing is late
while ``/clock`` stands still, and where that runs fast, a bound is one of real time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Final

# How many responses are remembered of each server, for the next look: they are looked at twice a second.
REMEMBERED: Final = 256


class SlowerClock:
    """A clock (ns) that goes on as the slower one of ``steady`` and ``ros``, if ``simulated``, else as the former.

    It may be used on any thread.
    """

    def __init__(self, steady: Callable[[], int], ros: Callable[[], int], simulated: Callable[[], bool]) -> None:
        self._steady, self._ros, self.simulated = steady, ros, simulated
        self._lock = threading.Lock()
        self._last = steady(), ros()
        self._at = 1  # 0 stands for never

    def __call__(self) -> int:
        with self._lock:
            now = self._steady(), self._ros()
            steady, ros = (later - earlier for later, earlier in zip(now, self._last, strict=True))
            self._at += max(0, min(steady, ros) if self.simulated() else steady)
            self._last = now
            return self._at


class ServedTimes:
    """The requests to one server; times are of ``clock``. May be used on any thread."""

    def __init__(self, clock: SlowerClock) -> None:
        self.clock = clock
        self._lock = threading.Lock()
        self._unanswered: dict[str, int] = {}  # since when
        self._took = [0] * REMEMBERED
        self.answered = 0
        self.busy = 0

    @property
    def took(self) -> Sequence[int]:
        """The times that the last responses took (us)."""
        return self._took

    @property
    def waiting(self) -> int:
        """Since when the oldest request is not answered; 0 where none waits."""
        with self._lock:
            return min(self._unanswered.values(), default=0)

    def came(self, request: str, waited: float = 0.0) -> None:
        """Note that ``request`` is handled from now on, and has ``waited`` for that (s of the steady clock).

        In simulated time, for how long it has waited is not known.
        """
        since = max(1, self.clock() - (0 if self.clock.simulated() else int(waited * 1e9)))
        with self._lock:
            self._unanswered[request] = since

    def ended(self, request: str) -> None:
        """Note that ``request`` was handled to the end."""
        now = self.clock()
        with self._lock:
            if (since := self._unanswered.pop(request, None)) is not None:
                self._took[self.answered % REMEMBERED] = (now - since) // 1000
                self.answered += 1
