"""When components with an agent of Midstride inside have written last, as they report: relays, and those with its API.

Nodes with a preloaded library show that in the page (:mod:`midstride.foreign.page`), which these do not write.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Final

from midstride.wire.state import ComponentState

# What a component has reported says nothing any more after so long (s); it reports twice a second.
FRESH: Final = 1.5


class ReportedWrites:
    """Of all components of a system that report."""

    def __init__(self) -> None:
        # By instance: when it has reported, and by topic when it had written last (steady s).
        self._reports: dict[str, tuple[float, Mapping[str, float]]] = {}

    def note(self, state: ComponentState) -> None:
        """A component has reported this. Times on `/clock` are not compared."""
        now = time.monotonic()
        written = {
            topic: now - link.measured.age
            for links in state.ports.values()
            for topic, link in links.items()
            if link.gate == "open" and link.measured is not None and link.measured.age is not None
        }
        self._reports[state.instance] = now, {} if state.simulated_time else written

    def silence(self, topic: str) -> float | None:
        """For how long no component that may publish on ``topic`` has written (s); None where none has, or reports."""
        now = time.monotonic()
        last = [written[topic] for at, written in self._reports.values() if topic in written and now - at < FRESH]
        return now - max(last) if last else None
