"""Counts of what has happened since the manager started: crashes, restarts, and changes by how they ended."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from midstride.runtime.records.measure import longest_gap, missed_messages
from midstride.runtime.records.reports import Outcome, OutcomeKind
from midstride.verdicts.assessment import Continuity

# The upper bounds of the classes of gaps (s); the last class has the rest.
GAP_BOUNDS: Final = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class LastChange:
    """The change that was reported last: when (UNIX time), and its figures; None where one is not known.

    ``gap`` and ``lost`` in seconds: the longest time without a message at a subscriber, and the longest time for which
    something was lost.
    """

    at: float
    seconds: float
    gap: float | None
    missed: int | None
    lost: float | None
    verdict: Continuity | None


@dataclass(slots=True)
class EventCounts:
    """Counts since ``since`` (UNIX time). ``crashes`` and ``respawns`` are by role, ``verdicts`` those of changes.

    ``gaps`` are the known gaps by their class (``GAP_BOUNDS``), ``gap_seconds`` their sum; ``missed`` the messages that
    are known to have been missed. Of ``gap_unknown`` changes with subscribers no gap is known.
    """

    since: float = field(default_factory=time.time)
    crashes: Counter[str] = field(default_factory=Counter)
    respawns: Counter[str] = field(default_factory=Counter)
    outcomes: Counter[OutcomeKind] = field(default_factory=Counter)
    verdicts: Counter[Continuity] = field(default_factory=Counter)
    gaps: list[int] = field(default_factory=lambda: [0] * (len(GAP_BOUNDS) + 1))
    gap_seconds: float = 0.0
    gap_unknown: int = 0
    missed: int = 0
    last_change: LastChange | None = None

    def changed(self, outcome: Outcome) -> None:
        """A change was reported, or refused: then nothing was changed, and the figures are those of the last one."""
        self.outcomes[outcome.outcome] += 1
        if outcome.outcome == "refused":
            return
        gap, missed, continuity = longest_gap(outcome.swaps), missed_messages(outcome.swaps), outcome.continuity
        if gap is not None:
            self.gaps[bisect_left(GAP_BOUNDS, gap)] += 1
            self.gap_seconds += gap
        elif outcome.swaps:
            self.gap_unknown += 1
        self.missed += missed or 0
        if continuity is not None:
            self.verdicts[continuity.verdict] += 1
        self.last_change = LastChange(
            time.time(),
            outcome.seconds,
            gap,
            missed,
            None if continuity is None else continuity.lost_seconds,
            None if continuity is None else continuity.verdict,
        )
