"""The times that servers took to answer while a graph was looked at, and the bound proposed for their guarantees."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from midstride.capture.rates import in_words
from midstride.model.wording import counted

# Fewer responses than these say nothing about a bound.
FEWEST: Final = 5
# A guarantee is to hold on a busier day, too: so many times the longest time that was seen, and at least this (s).
_MARGIN: Final = 2.0
_LEAST: Final = 0.01


@dataclass(frozen=True, slots=True)
class MeasuredAnswers:
    """So many requests were answered, and how long that took: their median and maximum (s)."""

    number: int
    median: float
    longest: float

    @property
    def bound(self) -> float:
        """The bound that is proposed for the guarantee (s), rounded up to one digit."""
        high = max(_LEAST, self.longest * _MARGIN)
        unit = 10.0 ** math.floor(math.log10(high))
        return float(f"{math.ceil(high / unit * (1 - 1e-9)) * unit:.3g}")

    def __str__(self) -> str:
        took = f"median {in_words(self.median)}, longest {in_words(self.longest)}"
        return f"answered {counted(self.number, 'request')}: {took}; proposed: within {in_words(self.bound)}"


def measured_answers(took: Sequence[float]) -> MeasuredAnswers | None:
    """Summarize these times (s); None if they are too few."""
    ordered = sorted(took)
    if len(ordered) < FEWEST:
        return None
    return MeasuredAnswers(len(ordered), ordered[(len(ordered) - 1) // 2], ordered[-1])
