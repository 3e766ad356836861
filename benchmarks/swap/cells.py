"""What is measured: each way under each condition, in which order, and how long that takes."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .streams import Stream
from .ways import Way

RATES = (10.0, 50.0, 200.0, 1000.0)
SIZES = (100, 10_000, 1_500_000)
LOADS = ("idle", "busy")
# More data per second is not asked of nodes in Python on a small machine (characters per second).
MOST = 150e6
# Before the first swap of a cell, and after the last (s).
AROUND = 10.0


@dataclass(frozen=True)
class Condition:
    """Under which condition a way is measured; ``load`` is one of LOADS."""

    stream: Stream
    load: str = "idle"

    def __str__(self) -> str:
        return f"{self.stream.rate:g} Hz, {size_in_words(self.stream.size)}, {self.load}"


@dataclass(frozen=True)
class Cell:
    """One way under one condition."""

    way: str
    condition: Condition

    @property
    def file(self) -> str:
        """The name of the file with its rows."""
        stream = self.condition.stream
        return f"{self.way}-{stream.rate:g}hz-{stream.size}b-{self.condition.load}.jsonl"


def size_in_words(size: int) -> str:
    """A size as people write it: 100 B, 10 kB, 1.5 MB."""
    for unit, name in ((1_000_000, "MB"), (1000, "kB")):
        if size >= unit:
            return f"{size / unit:g} {name}"
    return f"{size} B"


def conditions(
    rates: Iterable[float] = RATES, sizes: Iterable[int] = SIZES, loads: Iterable[str] = LOADS, every: bool = False
) -> list[Condition]:
    """Those in which one of rate, size and load is not the first one's of its list; with ``every``, all combinations.

    The base is 50 Hz, or else the first rate, with the first size and load. It comes first, as the other conditions
    show little without it. What exceeds ``MOST`` is left out.
    """
    rates, sizes, loads = list(rates), list(sizes), list(loads)
    rate = 50.0 if 50.0 in rates else rates[0]
    found = [Condition(Stream(each, size), load) for load in loads for size in sizes for each in rates]
    base = (rate, sizes[0], loads[0])

    def differs(condition: Condition) -> int:
        own = (condition.stream.rate, condition.stream.size, condition.load)
        return sum(one != other for one, other in zip(own, base, strict=True))

    found.sort(key=differs)
    return [each for each in found if (every or differs(each) <= 1) and each.stream.rate * each.stream.size <= MOST]


def in_order(chosen: Sequence[Condition], ways: Sequence[Way], seed: int) -> list[Cell]:
    """The cells, condition by condition, and under each the ways in an order by chance."""
    chance = random.Random(seed)
    cells = []
    for condition in chosen:
        cells += [Cell(way.name, condition) for way in chance.sample(ways, len(ways))]
    return cells


def seconds(cell: Cell, way: Way, swaps: int) -> float:
    """About how long a cell takes (s)."""
    return AROUND + swaps * (way.seconds + 2 * cell.condition.stream.tail)
