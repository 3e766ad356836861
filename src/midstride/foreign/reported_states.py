"""Reports of components with an agent of Midstride inside: what they have written and answered, and how `/clock` moves.

Nodes with a preloaded library show the first in the page (:mod:`midstride.foreign.page`), which relays and components
with the API do not write. Neither the page nor the manager has times on `/clock`. So a node without Midstride's API
that follows it is judged by its silence only where such a component does, too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Final

from msgspec.structs import replace

from midstride.node.control.response_watch import ResponseWatch
from midstride.wire.state import ComponentState, MeasuredResponses

# What a component has reported says nothing any more after so long (s); it reports twice a second.
FRESH: Final = 1.5
# How long it may have stood still before that is reported (s): a component waits for 2 s, and reports twice a second.
UNNOTICED: Final = 3.0


class ReportedStates:
    """Of all components of a system that report."""

    def __init__(self) -> None:
        # By instance: when it has reported, and by topic when it had written last (steady s).
        self._reports: dict[str, tuple[float, Mapping[str, float]]] = {}
        # By service or ROS action: when its server has reported, and how it answers.
        self._responses: dict[str, tuple[float, MeasuredResponses]] = {}
        self._speed = 0.0
        self._at = self._since = 0.0  # of the last report of `/clock`, and of the first since which it moves (steady s)

    def note(self, state: ComponentState, *, has_agent: bool = True) -> None:
        """A component has reported this; ``has_agent``: it is one inside it, which follows `/clock` itself.

        Times of writes on `/clock` are not compared.
        """
        now = time.monotonic()
        written = {
            topic: now - link.measured.age
            for links in state.ports.values()
            for topic, link in links.items()
            if link.gate == "open" and link.measured is not None and link.measured.age is not None
        }
        self._reports[state.instance] = now, {} if state.simulated_time else written
        if has_agent:
            self._responses |= {
                name: (now, link.responses)
                for links in state.ports.values()
                for name, link in links.items()
                if link.gate == "open" and link.responses is not None
            }
        if state.simulated_time and has_agent:
            if not self.speed or not state.clock_speed:
                self._since = now
            self._speed, self._at = state.clock_speed, now

    def silence(self, topic: str) -> float | None:
        """For how long no component that may publish on ``topic`` has written (s); None where none has, or reports."""
        now = time.monotonic()
        last = [written[topic] for at, written in self._reports.values() if topic in written and now - at < FRESH]
        return now - max(last) if last else None

    def responses(self, service: str, watch: ResponseWatch) -> MeasuredResponses | None:
        """The response times of the server of ``service`` against the bound of ``watch``; None where none reports that.

        Late is what is late by the server's own bound, which is no longer than the client's.
        """
        at, found = self._responses.get(service, (0.0, None))
        if found is None or time.monotonic() - at >= FRESH:
            return None
        broken = (found.broken or "has not answered in time") if found.silent > watch.tolerated else None
        return replace(found, within=watch.within, tolerated=watch.tolerated, broken=broken)

    @property
    def speed(self) -> float:
        """The seconds on `/clock` in each second; 0 where it stands still, or that is not known."""
        return self._speed if time.monotonic() - self._at < FRESH else 0.0

    def due(self, seconds: float) -> float | None:
        """For how long, of the last ``seconds``, something was due on it, at least; None where that is not known.

        As for components with an agent, that is longer where it is slow, and no less where it is fast.
        """
        speed, moving = self.speed, time.monotonic() - self._since
        return max(0.0, min(seconds, moving) - UNNOTICED) * min(speed, 1.0) if speed else None
