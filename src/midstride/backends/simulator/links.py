"""The lines between simulated hosts, which can be cut: what is sent meanwhile arrives when they are back, as on TCP."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from midstride.backends.simulator.virtual_clock import SimulatedClock


class Links:
    """A line is that from one host to another one, by their names; the way back is another line."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._cut: dict[tuple[str, str], float] = {}  # until when (steady s)
        self._held: dict[Callable[[], None], asyncio.TimerHandle] = {}

    def cut(self, sender: str, receiver: str, seconds: float) -> None:
        """Cut the line for ``seconds`` from now on."""
        line = sender, receiver
        self._cut[line] = max(self._cut.get(line, 0.0), self._clock.steady() + seconds)

    def is_cut(self, sender: str, receiver: str) -> bool:
        return self._cut.get((sender, receiver), 0.0) > self._clock.steady()

    def deliver(self, sender: str, receiver: str, latency: float, arrive: Callable[[], None]) -> None:
        """Call ``arrive`` after ``latency`` seconds, or when the line is back."""
        left = self._cut.get((sender, receiver), 0.0) - self._clock.steady()
        if left <= 0:
            self._clock.loop.call_later(latency, arrive)
            return

        def arrived() -> None:
            del self._held[arrived]
            arrive()

        self._held[arrived] = self._clock.loop.call_later(left + latency, arrived)

    def clear(self) -> None:
        """Every line is back."""
        self._cut.clear()
        for arrived, handle in list(self._held.items()):
            handle.cancel()
            self._clock.loop.call_soon(arrived)
