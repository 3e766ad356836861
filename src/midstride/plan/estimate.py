"""The duration of a kind of step: declared, or measured in earlier runs with its spread."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

_DIGITS: Final = 3


@dataclass(frozen=True, slots=True)
class Estimate:
    """A duration (s): what is expected, and the shortest and the longest that were measured."""

    seconds: float
    shortest: float
    longest: float

    @classmethod
    def exactly(cls, seconds: float) -> Estimate:
        """A declared duration, or a default: no spread is known."""
        return cls(seconds, seconds, seconds)

    @classmethod
    def of(cls, measured: Sequence[float]) -> Estimate:
        """The median of what was measured: one slow start does not change what is expected."""
        found = statistics.median(measured), min(measured), max(measured)
        return cls(*(round(seconds, _DIGITS) for seconds in found))

    def plus(self, seconds: float) -> Estimate:
        """With ``seconds`` more that are certain."""
        return Estimate(self.seconds + seconds, self.shortest + seconds, self.longest + seconds)

    def at_most(self, seconds: float) -> Estimate:
        """With ``seconds`` as the longest, unless more was measured."""
        return Estimate(self.seconds, self.shortest, max(self.longest, seconds))

    @property
    def between(self) -> tuple[float, float] | None:
        """The shortest and the longest; None where no spread is known."""
        return None if self.shortest == self.longest else (self.shortest, self.longest)
