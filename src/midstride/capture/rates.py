"""The rate of a publisher from the times of its messages, and the bound that is proposed for its guarantee."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

# Fewer gaps than these say nothing about a rate.
FEWEST: Final = 5
# A guarantee is to hold on a busier day, too: by so much it stays below what 95 % of the gaps correspond to.
_MARGIN: Final = 0.95
_DIGITS: Final = 2


@dataclass(frozen=True, slots=True)
class MeasuredRate:
    """A mean rate (Hz), and gaps between messages (s): their median, 95 % quantile and maximum."""

    mean: float
    median: float
    p95: float
    longest: float

    @property
    def bound(self) -> float:
        """The rate that is proposed for the guarantee (Hz), rounded down to two digits."""
        low = min(self.mean, 1 / self.p95) * _MARGIN
        unit = 10.0 ** (math.floor(math.log10(low)) - _DIGITS + 1)
        return float(f"{math.floor(low / unit * (1 + 1e-9)) * unit:.6g}")

    def __str__(self) -> str:
        gaps = f"gaps: median {in_words(self.median)}, 95 % {in_words(self.p95)}, longest {in_words(self.longest)}"
        return f"measured {self.mean:.4g} Hz; {gaps}; proposed: @ {self.bound:g} Hz"


def measured(times: Sequence[float]) -> MeasuredRate | None:
    """The rate of messages that were written at ``times`` (s); None if there are too few."""
    ordered = sorted(times)
    gaps = sorted(later - earlier for earlier, later in pairwise(ordered))
    if len(gaps) < FEWEST or (covered := ordered[-1] - ordered[0]) <= 0:
        return None
    p95 = _quantile(gaps, 0.95)
    return MeasuredRate(len(gaps) / covered, _quantile(gaps, 0.5), max(p95, 1e-9), gaps[-1])


def _quantile(ordered: Sequence[float], share: float) -> float:
    return ordered[min(len(ordered) - 1, math.ceil(share * len(ordered)) - 1)]


def in_words(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds < 0.9995 else f"{seconds:.3g} s"  # what rounds to 1 s is a second
