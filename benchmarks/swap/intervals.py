"""Intervals of the figures: a bootstrap for a median, Clopper and Pearson's for a share."""

from __future__ import annotations

import math
import random
import statistics
from collections.abc import Callable, Sequence

LEVEL = 0.95


def quantile(ordered: Sequence[float], share: float) -> float:
    """The smallest of the ``ordered`` values that at least this share of them does not exceed."""
    return ordered[min(len(ordered) - 1, max(0, math.ceil(share * len(ordered) - 1e-9) - 1))]


def bootstrap(
    values: Sequence[float],
    figure: Callable[[Sequence[float]], float] = statistics.median,
    seed: int = 0,
    samples: int = 2000,
) -> tuple[float, float]:
    """The percentile interval of a figure of ``values``, from ``samples`` drawings with replacement. Needs a value."""
    chance = random.Random(seed)
    found = sorted(figure(chance.choices(values, k=len(values))) for _ in range(samples))
    return quantile(found, (1 - LEVEL) / 2), quantile(found, (1 + LEVEL) / 2)


def clopper_pearson(hits: int, of: int) -> tuple[float, float]:
    """The exact interval of the probability of which ``hits`` of ``of`` independent trials are an outcome."""
    rest = (1 - LEVEL) / 2
    low = 0.0 if hits == 0 else _where(lambda p: 1 - _at_most(hits - 1, of, p) >= rest)
    high = 1.0 if hits == of else _where(lambda p: _at_most(hits, of, p) <= rest)
    return low, high


def _at_most(hits: int, of: int, p: float) -> float:
    return math.fsum(math.comb(of, each) * p**each * (1 - p) ** (of - each) for each in range(hits + 1))


def _where(holds: Callable[[float], bool]) -> float:
    """The least probability from which on it holds, by halving."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
