"""By how much the clock of another host is ahead of this one, and how sure that is, from a few questions and answers.

As in NTP: the other host reads its clock at some moment between a question and its answer. So the answer with the least
round trip says most, and nothing is assumed of how the two ways share that time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

# By how much two clocks drift apart at most (s for each s): a crystal is off by a hundred millionths at most, and a
# clock that is synchronised is corrected by five hundred millionths at most, each of two.
DRIFT: Final = 0.0012


@dataclass(frozen=True, slots=True)
class ClockAnswer:
    """One question, ``asked`` and ``answered`` on the clock here; ``other`` is what the other one showed (all ns)."""

    asked: int
    other: int
    answered: int

    @property
    def round_trip(self) -> int:
        return self.answered - self.asked


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """The other clock is ``ahead`` of this one, give or take ``uncertainty``, when this one shows ``at`` (ns)."""

    ahead: int
    uncertainty: int
    at: int

    def uncertainty_at(self, now: int) -> int:
        """The uncertainty when the clock here shows ``now``: the two clocks may have drifted apart since."""
        return self.uncertainty + round(DRIFT * abs(now - self.at)) if self.uncertainty else 0

    def between(self, third: ClockOffset) -> ClockOffset:
        """By how much a ``third`` clock is ahead of the other one, at the later moment of both measurements."""
        at = max(self.at, third.at)
        return ClockOffset(third.ahead - self.ahead, self.uncertainty_at(at) + third.uncertainty_at(at), at)

    def to_other(self, here: int) -> int:
        """The reading of the other clock when the one here shows ``here``."""
        return here + self.ahead

    def to_here(self, other: int) -> int:
        """The reading of the clock here when the other one shows ``other``."""
        return other - self.ahead


# Of a clock to itself.
SAME_CLOCK: Final = ClockOffset(0, 0, 0)


def clock_offset(exchanges: Iterable[ClockAnswer]) -> ClockOffset | None:
    """The offset by the exchange with the least round trip; None without one, or where the clock here went back."""
    usable = [each for each in exchanges if each.round_trip >= 0]
    if not usable:
        return None
    best = min(usable, key=lambda each: each.round_trip)
    half = best.round_trip / 2
    return ClockOffset(round(best.other - best.asked - half), -(-best.round_trip // 2), best.answered)
