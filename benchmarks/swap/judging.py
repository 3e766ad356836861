"""The figures of a swap, from the rows of a recorder outside, by the same rule for every way of swapping.

Two talkers of one rate have slots of different phases, so slots say nothing where one follows the other: what is
counted there is the silence. Each talker keeps its own rate, and is judged by how many messages it has written.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

# A silence that is shorter by this part of a period is a whole one: two talkers may each be a little early or late.
JITTER = 0.1
# The window reaches this many periods before the swap.
WINDOW_PERIODS = 20


class Row(NamedTuple):
    """A received message: when it was received and written (steady ns), its number, and the talker that wrote it."""

    received: int
    sent: int
    number: int
    talker: str


@dataclass(frozen=True)
class Figures:
    """The figures of one swap.

    ``gap``: the longest time without a message (s). ``missed``: messages that a talker left out, by its rate, and whole
    periods of silence beyond the first one where another talker follows. ``lost``: written between two messages that
    were received, and not received. ``twice``: received again. ``overlapping``: by the first talker, written and
    received after a message of another one, which went on. ``reordered``: received after a later message of its
    talker.
    """

    gap: float
    missed: int
    lost: int
    twice: int
    overlapping: int
    reordered: int


def judged(heard: Iterable[Row], begun: int, ended: int, period: float) -> Figures:
    """The figures of a swap that lasted from ``begun`` to ``ended`` (steady ns), at one message each ``period`` (s)."""
    window = begun - round(WINDOW_PERIODS * period * 1e9)
    rows = sorted(row for row in heard if window <= row.received <= ended)
    step = period * 1e9
    if not rows:
        return Figures((ended - begun) / 1e9, math.floor((ended - begun) / step), 0, 0, 0, 0)
    distinct = {(row.talker, row.number): row for row in reversed(rows)}
    times = [*(row.received for row in rows), ended]
    return Figures(
        gap=max(after - before for before, after in itertools.pairwise(times)) / 1e9,
        missed=_missed(sorted(distinct.values(), key=_sent), rows[-1].received, ended, step),
        lost=_lost(distinct),
        twice=len(rows) - len(distinct),
        overlapping=_overlapping(sorted(distinct.values(), key=_sent)),
        reordered=_reordered(rows),
    )


def _sent(row: Row) -> int:
    return row.sent


def _missed(rows: Sequence[Row], last: int, ended: int, step: float) -> int:
    """``rows`` in the order in which they were written; ``last``: when the last one was received."""
    stretches = [list(own) for _, own in itertools.groupby(rows, key=lambda row: row.talker)]
    missed = sum(_left_out(own, step) for own in stretches)
    missed += sum(_silent(new[0].sent - old[-1].sent, step) for old, new in itertools.pairwise(stretches))
    return missed + _silent(ended - last, step)


def _silent(silence: int, step: float) -> int:
    return max(0, math.floor(silence / step + JITTER) - 1)


def _left_out(own: Sequence[Row], step: float) -> int:
    """How many messages are too few for the time from its first to its last one; a lost one was written."""
    due = round((own[-1].sent - own[0].sent) / step)
    return max(0, due - (own[-1].number - own[0].number))


def _lost(distinct: Iterable[tuple[str, int]]) -> int:
    numbers: dict[str, list[int]] = {}
    for talker, number in distinct:
        numbers.setdefault(talker, []).append(number)
    return sum(max(own) - min(own) + 1 - len(own) for own in numbers.values())


def _overlapping(rows: Sequence[Row]) -> int:
    first = rows[0].talker
    others = [row for row in rows if row.talker != first]
    sent = [row.sent for row in others]
    earliest = list(itertools.accumulate((row.received for row in others), min))

    def beside(row: Row) -> bool:
        before = bisect.bisect_left(sent, row.sent)  # so many of the others were written before
        return before > 0 and earliest[before - 1] < row.received and row.sent < sent[-1]

    return sum(row.talker == first and beside(row) for row in rows)


def _reordered(rows: Sequence[Row]) -> int:
    return sum(1 for _ in _late(rows))


def _late(rows: Sequence[Row]) -> Iterator[Row]:
    """Messages that were received for the first time after a later one of the same talker."""
    seen, highest = set[tuple[str, int]](), dict[str, int]()
    for row in rows:
        if (row.talker, row.number) in seen:
            continue
        seen.add((row.talker, row.number))
        if row.number < highest.get(row.talker, row.number):
            yield row
        highest[row.talker] = max(row.number, highest.get(row.talker, row.number))
