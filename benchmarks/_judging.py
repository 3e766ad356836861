"""The figures of a swap, from the rows of a recorder outside, by the same rule for every way of swapping.

Two talkers of one rate have slots of different phases, so slots say nothing where one follows the other: what is
counted there is the silence. Each talker keeps its own rate, and is judged by how many messages it has written.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence

import msgspec

from midstride.runtime.records.measure import WINDOW_PERIODS, Observation, SwapReport, report
from midstride.wire.replies import Receipt

# A silence that is shorter by this part of a period is a whole one: two talkers may each be a little early or late.
JITTER = 0.1


def judged(seen: Observation) -> SwapReport:
    """Report a swap as in docs/protocols/measurement.md, but for ``missed`` and ``duplicates``: without common slots.

    ``missed``: messages that a talker left out, by its rate, and whole periods of silence beyond the first one where
    another talker follows. ``duplicates``: messages of the first talker while another one already talked, and messages
    that were received twice.
    """
    assert seen.guaranteed_period is not None
    period = seen.guaranteed_period
    begun = seen.begun - round(WINDOW_PERIODS * period * 1e9)
    rows = _talkers(sorted((row for row in seen.rows if begun <= row.received <= seen.ended), key=_source))
    told = report(dataclasses.replace(seen, rows=rows))
    if not rows:
        return told
    if any(row.publisher is None for row in rows):
        return msgspec.structs.replace(told, missed=None, duplicates=None)
    return msgspec.structs.replace(told, missed=_missed(rows, seen.ended, period), duplicates=_duplicates(rows))


def _source(row: Receipt) -> int:
    assert row.source is not None
    return row.source


def _talkers(rows: Sequence[Receipt]) -> list[Receipt]:
    """Return ``rows`` with another talker where a publisher's numbers begin anew: its node was made again."""
    found: list[Receipt] = []
    last: dict[str, int] = {}
    times = Counter[str]()
    for row in rows:
        name = row.publisher
        if name is not None and row.number is not None:
            times[name] += row.number < last.get(name, 0)
            last[name] = row.number
            row = msgspec.structs.replace(row, publisher=f"{name}#{times[name]}")
        found.append(row)
    return found


def _stretches(rows: Sequence[Receipt]) -> Iterator[list[Receipt]]:
    """Messages that one talker wrote without another one between them."""
    for _, own in itertools.groupby(rows, key=lambda row: row.publisher):
        yield list(own)


def _missed(rows: Sequence[Receipt], ended: int, period: float) -> int:
    step = period * 1e9
    stretches = list(_stretches(rows))
    missed = sum(_left_out(own, step) for own in stretches)
    missed += sum(_silent(_source(new[0]) - _source(old[-1]), step) for old, new in itertools.pairwise(stretches))
    return missed + _silent(ended - max(row.received for row in rows), step)


def _silent(silence: int, step: float) -> int:
    return max(0, math.floor(silence / step + JITTER) - 1)


def _left_out(own: Sequence[Receipt], step: float) -> int:
    """How many messages are too few for the time from its first to its last one; a lost one was written."""
    due = round((_source(own[-1]) - _source(own[0])) / step)
    first, last = own[0].number, own[-1].number
    written = len(own) - 1 if first is None or last is None else last - first
    return max(0, due - written)


def _duplicates(rows: Sequence[Receipt]) -> int:
    first = rows[0].publisher
    others = [_source(row) for row in rows if row.publisher != first]
    beside = sum(row.publisher == first and min(others) < _source(row) < max(others) for row in rows) if others else 0
    numbered = [(row.publisher, row.number) for row in rows if row.number is not None]
    return beside + len(numbered) - len({*numbered})
