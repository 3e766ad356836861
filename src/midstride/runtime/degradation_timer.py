"""The measured cost of a plan: how long each functionality is below its baseline while the plan is carried out.

The levels are those of docs/semantics.md section 6, by role. Only the time from the start of the first step to the end
of the last one counts.
"""

from __future__ import annotations

from collections.abc import Callable

from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.plan.change import Change
from midstride.plan.disruption import Levels


class DegradationTimer:
    """Sums the seconds below the baseline; :meth:`moved` must be called with each configuration as it is reached."""

    def __init__(self, change: Change, steady: Callable[[], float]) -> None:
        self._levels = Levels(change)
        self._steady = steady
        self._roles = sorted({*change.specification.nodes} & {*change.target.nodes})
        self._since = steady()
        self._below = self._levels.fallen(change.start, self._roles)
        self._seconds: dict[FunctionalityRef, float] = dict.fromkeys(self._below, 0.0)

    def moved(self, configuration: Configuration) -> None:
        """A step has led to ``configuration``, now."""
        now = self._steady()
        for ref in self._below:
            self._seconds[ref] += now - self._since
        self._since = now
        self._below = self._levels.fallen(configuration, self._roles)
        for ref in self._below:
            self._seconds.setdefault(ref, 0.0)

    def stop(self) -> dict[str, float]:
        """The seconds below the baseline of each functionality that has been below it, by role."""
        now = self._steady()
        for ref in self._below:
            self._seconds[ref] += now - self._since
        self._since = now
        return {str(ref): round(seconds, 6) for ref, seconds in sorted(self._seconds.items())}
