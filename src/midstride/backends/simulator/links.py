"""The lines between simulated hosts: they can be cut, and be slow or lossy.

What is sent over a line that is cut arrives when it is back, as on TCP, and what is lost is sent again.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable
from typing import Final

from midstride.backends.simulator.virtual_clock import SimulatedClock

# How long it takes until what was lost is sent again (s).
SENT_AGAIN: Final = 0.2


class Links:
    """A line is that from one host to another one, by their names; the way back is another line.

    ``random``: what is lost is drawn from it.
    """

    def __init__(self, clock: SimulatedClock, random: random.Random) -> None:
        self._clock = clock
        self.random = random
        self._cut: dict[tuple[str, str], tuple[float, float]] = {}  # since when, and until when (steady s)
        self._held: dict[Callable[[], None], asyncio.TimerHandle] = {}
        self._late: dict[str, float] = {}  # by host: when something has arrived last that was held (steady s)
        self._delays: dict[tuple[str, str], float] = {}
        self._losses: dict[tuple[str, str], float] = {}

    def cut(self, sender: str, receiver: str, seconds: float) -> None:
        """Cut the line for ``seconds`` from now on."""
        line, now = (sender, receiver), self._clock.steady()
        since, until = self._cut.get(line, (now, 0.0))
        self._cut[line] = (since if until > now else now), max(until, now + seconds)

    def slow(self, sender: str, receiver: str, seconds: float) -> None:
        """Have each message over the line take so many seconds longer from now on."""
        self._delays[sender, receiver] = seconds

    def lose(self, sender: str, receiver: str, part: float) -> None:
        """Lose this part of what is sent over the line, drawn at random, from now on."""
        self._losses[sender, receiver] = part

    def is_cut(self, sender: str, receiver: str) -> bool:
        return bool(self._cut) and self._until(sender, receiver) > self._clock.steady()

    def cut_since(self, sender: str, receiver: str) -> float:
        """Since when the line is cut (steady s); infinite where it is not."""
        since, until = self._cut.get((sender, receiver), (math.inf, 0.0))
        return since if until > self._clock.steady() else math.inf

    def late_at(self, receiver: str) -> float:
        """The time when what a cut had held back was last sent on to a host (steady s); minus infinity if never."""
        return self._late.get(receiver, -math.inf)

    @property
    def any_cut(self) -> bool:
        """Return whether a line has been cut since all were cleared."""
        return bool(self._cut)

    def _until(self, sender: str, receiver: str) -> float:
        return self._cut.get((sender, receiver), (0.0, 0.0))[1]

    def loses(self, sender: str, receiver: str) -> bool:
        """Return whether a datagram that is sent over the line now is lost."""
        part = self._losses.get((sender, receiver), 0.0)
        return self.is_cut(sender, receiver) or (part > 0 and self.random.random() < part)

    def deliver(self, sender: str, receiver: str, latency: float, arrive: Callable[[], None]) -> None:
        """Call ``arrive`` after ``latency`` seconds; or later, when the line is back and nothing is lost any more."""
        if not self.is_cut(sender, receiver):
            latency += self._delays.get((sender, receiver), 0.0)
            while (part := self._losses.get((sender, receiver), 0.0)) > 0 and self.random.random() < part:
                latency += SENT_AGAIN
            self._clock.loop.call_later(latency, arrive)
            return

        def back() -> None:
            del self._held[back]
            self._late[receiver] = self._clock.steady()
            self.deliver(sender, receiver, latency, arrive)

        left = self._until(sender, receiver) - self._clock.steady()
        self._held[back] = self._clock.loop.call_later(left, back)

    def clear(self) -> None:
        """Every line is back, and as fast and sure as before."""
        self._cut.clear()
        self._delays.clear()
        self._losses.clear()
        for back, handle in list(self._held.items()):
            handle.cancel()
            self._clock.loop.call_soon(back)
