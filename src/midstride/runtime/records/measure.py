"""The figures of a subscriber while a publisher was replaced: gap, missed, lost, duplicates.

The figures are defined in docs/protocols/measurement.md. The functions are pure. A row is a received message: time of
receipt (steady clock of the subscriber, ns), source time (ns), sequence number and identity of the publisher. Where the
middleware does not provide one of these it is None, and so is every figure that needs it.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from midstride.codec.form import Form
from midstride.wire.replies import Receipt

# The window reaches this many periods before the first step and after the last.
WINDOW_PERIODS: Final = 20
# A message may precede its slot by this fraction of a period because of the publisher's jitter.
_EARLY: Final = 0.25
# A publisher that answers less than this fraction of its inputs does not write one answer to each.
_ANSWERED: Final = 0.8
# A message may be written after this many later slots have begun, an answer after this many later inputs.
_LATE: Final = 5

_Publishers = dict[str, list[Receipt]]  # the rows of each


class SwapReport(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """The figures of one subscriber of one swapped topic. ``period`` and ``gap`` in seconds; None if unknown."""

    topic: str
    subscriber: str
    period: float | None
    gap: float | None
    gap_periods: float | None
    missed: int | None
    lost: int | None
    duplicates: int | None


def unknown_report(topic: str, subscriber: str, period: float | None) -> SwapReport:
    return SwapReport(topic, subscriber, period, None, None, None, None, None)


def longest_gap(swaps: Sequence[SwapReport]) -> float | None:
    """The longest gap (s) at the subscribers of a change; None if there is none, or one of them is not known."""
    gaps = [swap.gap for swap in swaps]
    return None if None in gaps else max(gaps, default=None)  # type: ignore[type-var]


def missed_messages(swaps: Sequence[SwapReport]) -> int | None:
    """The messages that all subscribers have missed; None if there are none, or one does not know."""
    counts = [swap.missed for swap in swaps]
    return None if None in counts or not counts else sum(filter(None, counts))


@dataclass(frozen=True, slots=True)
class Observation:
    """The messages recorded at one input between two times of its steady clock (ns).

    ``last_number`` is the number of the old publisher's last message, and ``first_number`` that of the new one's first,
    as they report them. ``inputs`` are the source times of the messages that a message-driven publisher had to answer,
    if known: they serve as its time grid. ``resumed``: the change was rolled back, so the old publisher is the one at
    the end, too. ``watched``: how long the recording continued after the last step (s), where that is not 20 periods;
    ``earliest``: rows before belong to another change. ``hung``: the old publisher may have been silent before: the
    figures begin with its last message. ``own_slots``: the new publisher is a program outside, which writes on its own
    grid and not on that of the old one.
    """

    topic: str
    subscriber: str
    rows: Sequence[Receipt]
    begun: int
    ended: int
    guaranteed_period: float | None
    grid_period: float | None = None
    last_number: int | None = None
    first_number: int | None = None
    inputs: Sequence[int] | None = None
    resumed: bool = False
    watched: float = math.inf
    earliest: int = 0
    hung: bool = False
    own_slots: bool = False


def report(seen: Observation) -> SwapReport:
    """The figures of one observation. ``ended`` includes the tail after the last step."""
    period = seen.guaranteed_period
    rows = _window(seen, period or seen.grid_period)
    gap = _gap(rows, seen.begun, seen.ended) if period else None
    by_publisher = _by_publisher(rows, seen)
    missed = duplicates = None
    grid = seen.grid_period or period
    tail = seen.ended - min(WINDOW_PERIODS * (grid or 0.0), seen.watched) / 2 * 1e9
    by_side = None if by_publisher is None else _swapped(by_publisher, seen, tail)
    if grid and not rows:
        missed = math.floor((seen.ended - seen.begun) / (grid * 1e9))
    elif grid and by_side is not None and not _clock_was_set(rows, seen.ended):
        answered = None if seen.inputs is None else _answers(by_side, seen.inputs)
        missed, duplicates = answered or _slots(rows, by_side, grid, seen.ended)
        if seen.own_slots and duplicates is not None:
            duplicates = _overlap(list(by_side.values()), seen.resumed)
    if seen.hung and not any(row.received <= seen.begun for row in rows):
        gap = missed = None  # since when it was silent is not known
    return SwapReport(
        topic=seen.topic,
        subscriber=seen.subscriber,
        period=period,
        gap=None if gap is None else round(gap, 6),
        gap_periods=None if gap is None or not period else round(gap / period, 3),
        missed=missed,
        lost=_lost(by_publisher, by_side, seen),
        duplicates=duplicates,
    )


def _window(seen: Observation, period: float | None) -> list[Receipt]:
    begun = seen.begun
    if seen.hung:
        begun = max((row.received for row in seen.rows if row.received <= begun), default=begun)
    start = max(seen.earliest, begun - int(WINDOW_PERIODS * period * 1e9) if period else seen.earliest)
    return sorted((row for row in seen.rows if start <= row.received <= seen.ended), key=lambda row: row.received)


def _gap(rows: Sequence[Receipt], begun: int, ended: int) -> float:
    """The longest silence, including the one before the end of the window, in case the topic stays silent."""
    times = [row.received for row in rows] or [begun]
    times.append(ended)
    return max(later - earlier for earlier, later in itertools.pairwise(times)) / 1e9


def _clock_was_set(rows: Sequence[Receipt], ended: int) -> bool:
    """Return whether no transmission explains how far the times of publication are from those of receipt.

    Then the clock of a publisher was set meanwhile, and its slots mean nothing.
    """
    offsets = [row.received - row.source for row in rows if row.source is not None]
    return bool(offsets) and max(offsets) - min(offsets) > ended - rows[0].received


def _by_publisher(rows: Sequence[Receipt], seen: Observation) -> _Publishers | None:
    """The rows of each publisher, distinguished by identity or else by sequence numbers; None if neither is known."""
    begun, last_number = seen.begun, seen.last_number
    found: _Publishers = {}
    if all(row.publisher is not None for row in rows):
        for row in rows:
            found.setdefault(str(row.publisher), []).append(row)
        return found
    if any(row.number is None for row in rows):
        return None
    # Without identities: the numbers of a publisher increase; a row that continues no sequence starts another.
    tails: dict[str, int] = {}
    for row in rows:
        number = row.number
        assert number is not None
        # The first sequence is the old publisher's; it ends with the last number that the old publisher reported.
        ended = next(iter(tails), None) if last_number is not None and number > last_number else None
        nearest = [name for name, tail in tails.items() if 0 < number - tail <= 1000 and name != ended]
        exact = [name for name in nearest if tails[name] == number - 1]
        if seen.hung and len(nearest) > 1:  # one that has been silent since before the change has been fenced
            nearest = [name for name in nearest if found[name][-1].received > begun] or nearest
            exact = [name for name in exact if name in nearest]
        if len(exact) > 1 or (not exact and len(nearest) > 1):
            return None  # ambiguous: it may continue two sequences
        name = (exact or nearest or [f"#{len(tails)}"])[0]
        if not exact and nearest and row.received > begun and number <= 2:
            name = f"#{len(tails)}"  # a new sequence, not a jump in the old one
        tails[name] = number
        found.setdefault(name, []).append(row)
    return found


def _swapped(by_publisher: _Publishers, seen: Observation, tail: float) -> _Publishers | None:
    """The rows of the publishers that took part in the swap (others would hide holes); None if they are not known.

    These are the ones that appeared or disappeared, and all if none did. An old publisher that resumed did neither.
    """
    moved = {name: own for name, own in by_publisher.items() if own[0].received > seen.begun or own[-1].received < tail}
    if not moved:
        return by_publisher
    if seen.resumed and all(own[0].received > seen.begun for own in moved.values()):
        stayed = {name: own for name, own in by_publisher.items() if name not in moved}
        return moved | stayed if len(stayed) == 1 else None
    return moved


def _slots(rows: Sequence[Receipt], by_side: _Publishers, period: float, ended: int) -> tuple[int | None, int | None]:
    """Empty slots of the old publisher's grid by source time, and slots with messages of two publishers."""
    if any(row.source is None for row in rows):
        return None, None
    step = period * 1e9
    names = list(by_side)
    old = min(names, key=lambda name: by_side[name][0].received)
    origin = _phase([_source(row) for row in by_side[old]], step)
    slots = {name: list(_assign([_source(row) for row in by_side[name]], origin, step)) for name in names}
    _shift_late(slots)
    _shift_early(slots)
    filled: dict[int, set[str]] = {}
    for name, own in slots.items():
        for slot in own:
            filled.setdefault(slot, set()).add(name)
    # The end of the window on the source's clock, estimated from the fastest transmission.
    offset = min(row.received - _source(row) for row in rows)
    first, last = min(filled), max(filled)
    last_due = math.floor((ended - offset - origin) / step) - 1
    missed = sum(1 for slot in range(first, max(last, last_due) + 1) if slot not in filled)
    duplicates = sum(1 for owners in filled.values() if len(owners) > 1)
    return missed, duplicates


def _overlap(sides: Sequence[Sequence[Receipt]], resumed: bool) -> int:
    """The number of messages of the first publisher that were published after the first one of another.

    If it ``resumed``, those after the last one of the other are no duplicates.
    """
    first, *others = sorted(sides, key=lambda own: own[0].received)
    begun = min((_source(own[0]) for own in others), default=math.inf)
    ended = max((_source(own[-1]) for own in others), default=math.inf) if resumed else math.inf
    return sum(begun < _source(row) < ended for row in first)


def _source(row: Receipt) -> int:
    assert row.source is not None
    return row.source


def _phase(sources: Sequence[int], step: float) -> float:
    """A source time that is exactly on the grid of ``sources``, at the early end of their jitter."""
    best_spread, best_origin = math.inf, float(sources[0])
    for reference in sources[:: max(1, len(sources) // 16)]:
        deviations = sorted((source - reference + step / 2) % step - step / 2 for source in sources)
        middle = deviations[len(deviations) // 2]
        spread = sum(abs(deviation - middle) for deviation in deviations)
        if spread < best_spread:
            best_spread, best_origin = spread, reference + deviations[len(deviations) // 10]
    return best_origin


def _assign(sources: Sequence[int], origin: float, step: float) -> Iterable[int]:
    """The slot of each message of one publisher, on the old grid.

    A publisher keeps its phase, so its offset within a slot is determined once for all its messages. A message that is
    late by more than that, and followed by one on time, belongs to the slot before.
    """
    own = _phase(sources, step)
    shift = math.floor((own - origin) / step + _EARLY)
    places = [(source - own) / step for source in sorted(sources)]
    slots = [math.floor(place + _EARLY) for place in places]
    for index in range(len(slots) - 2, -1, -1):
        if slots[index] >= slots[index + 1]:
            slots[index] = max(slots[index] - 1, slots[index + 1] - 1)
    for index in range(1, len(slots)):  # after a hole: not slightly early, but late for the slot before
        if slots[index] - slots[index - 1] == 2 and places[index] < slots[index]:
            slots[index] -= 1
    return [slot + shift for slot in slots]


def _answers(by_side: _Publishers, inputs: Sequence[int]) -> tuple[int, int] | None:
    """The number of inputs without an answer, and of inputs that two publishers answered.

    None if the publishers do not answer each input with one message, so that the inputs are not their grid. The last
    inputs may not have been answered yet, and are not counted.
    """
    slots = sorted(set(inputs))
    answers: dict[str, list[int]] = {}
    for name, rows in by_side.items():
        following = len(slots)
        own = answers.setdefault(name, [])
        for source in sorted((row.source for row in rows if row.source is not None), reverse=True):
            following = min(bisect.bisect_right(slots, source), following) - 1
            if following < 0:
                break  # answers to inputs before the first known one
            own.append(following)
        own.reverse()
    _shift_late(answers)
    answered = Counter(slot for own in answers.values() for slot in own)
    if not answered or len(answered) < _ANSWERED * len(slots):
        return None
    missed = sum(1 for slot in range(max(answered)) if slot not in answered)
    return missed, sum(1 for count in answered.values() if count > 1)


def _sides(written: dict[str, list[int]]) -> list[list[int]]:
    """The messages of each publisher, the old one first."""
    return sorted((own for own in written.values() if own), key=lambda own: own[0])


def _shift_late(written: dict[str, list[int]]) -> None:
    """Assign late last messages of the old publisher to the slots (or inputs) before.

    By time alone, one written after the next slot began counts as a duplicate of the new publisher's message in that
    slot, and the slot that it belongs to as missed.
    """
    sides = _sides(written)
    if len(sides) < 2:
        return
    old, new = sides[0], {slot for own in sides[1:] for slot in own}
    for _ in range(_LATE):
        free = [slot for slot in range(max(old[0], old[-1] - _LATE), old[-1]) if slot not in old and slot not in new]
        if not free or old[-1] not in new:
            return
        old[:] = [slot - 1 if slot > free[-1] else slot for slot in old]


def _shift_early(written: dict[str, list[int]]) -> None:
    """Assign early first messages of the new publisher to the slots after.

    In simulated time, a message seems early whose subscriber received ``/clock`` late.
    """
    sides = _sides(written)
    if len(sides) < 2:
        return
    old, new = set(sides[0]), sides[1]
    for _ in range(_LATE):
        free = [slot for slot in range(new[0] + 1, min(new[-1], new[0] + _LATE)) if slot not in old and slot not in new]
        if not free or new[0] not in old:
            return
        new[:] = [slot + 1 if slot < free[0] else slot for slot in new]


def _lost(by_publisher: _Publishers | None, by_side: _Publishers | None, seen: Observation) -> int | None:
    """The holes in each publisher's sequence, and what was not received of the old one's end and the new one's begin.

    Which the new one is must be known for that: the only one that appeared during the change.
    """
    if not by_publisher or any(row.number is None for own in by_publisher.values() for row in own):
        return None
    numbers = {name: {row.number for row in own if row.number is not None} for name, own in by_publisher.items()}
    lost = sum(max(own) - min(own) + 1 - len(own) for own in numbers.values())
    if seen.last_number is not None:
        if by_side is None:
            return None
        old = min(by_side, key=lambda name: by_side[name][0].received)
        begins = [name for name, own in by_side.items() if own[0].received > seen.begun and min(numbers[name]) == 1]
        if begins == [old]:
            return None  # these are the new publisher's messages: none of the old one's is in the window
        lost += max(0, seen.last_number - max(numbers[old]))
    if seen.first_number is not None and by_side is not None:
        appeared = [name for name, own in by_side.items() if own[0].received > seen.begun]
        if len(appeared) == 1 < len(by_side):
            lost += max(0, min(numbers[appeared[0]]) - seen.first_number)
    return lost
