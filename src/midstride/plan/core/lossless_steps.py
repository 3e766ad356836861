"""Replacements that lose nothing as the next step, or as the last ones, so that the search need not try other moments.

The proof is in docs/decisions/least-disruption.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from midstride.plan.core.conflict_core import Part
from midstride.plan.core.core_bounds import RoleBounds
from midstride.plan.core.core_losses import PartLosses

# Several replacements, by their numbers.
Numbers: TypeAlias = int


@dataclass(frozen=True, slots=True)
class Replacement:
    """A role whose old and new instance do the same, with all of its actions by bit.

    ``extra`` is what the role costs more, at least, if the old instance goes first; ``old`` and ``new`` are what they
    hold of each resource.
    """

    bits: int
    create: int
    exchanges: tuple[int, ...]
    remove: int
    old: tuple[int, ...]
    new: tuple[int, ...]
    extra: float

    def moves(self) -> tuple[int, ...]:
        """The sets of actions that make it, in order: old and new are there side by side."""
        return self.create, *self.exchanges, self.remove


class Ends:
    """The replacements of a part that may be made next or last, in whatever state the search has reached.

    None where something is lost at the start or at the end, or where an order counts.
    """

    def __init__(self, part: Part, losses: PartLosses, bounds: RoleBounds) -> None:
        self._part = part
        some = not (any(part.after) or losses.loss(0) or losses.loss(part.everything))
        self.replacements = sorted(_found(part, losses, bounds), key=lambda each: -each.extra) if some else []
        self._timed = [
            (1 << bit, part.usage[bit]) for bit, op in enumerate(part.ops) if op.port is None and any(part.usage[bit])
        ]
        self._last: dict[Numbers, tuple[int, tuple[int, ...]]] = {}

    def never_absent(self, state: int, slack: float) -> Numbers:
        """The steps not begun in ``state`` whose old one cannot go first for less than ``slack`` more."""
        numbers = 0
        for number, each in enumerate(self.replacements):
            if each.extra < slack:
                break
            if not state & each.bits:
                numbers |= 1 << number
        return numbers

    def first(self, state: int, numbers: Numbers, later: int) -> int:
        """The state after one of ``numbers`` that fits beside its old instance and takes no more; else ``state``.

        Nothing is lost in ``state``. Those whose actions are in ``later`` are left out.
        """
        free = self._free(state)
        for number, each in enumerate(self.replacements):
            may = numbers >> number & 1 and not each.bits & later
            if may and _at_most(each.new, each.old) and _at_most(each.new, free):
                return state | each.bits
        return state

    def last(self, numbers: Numbers) -> tuple[int, tuple[int, ...]]:
        """The steps of ``numbers`` that can be made when all else is done: all of their actions, in order."""
        found = self._last.get(numbers)
        if found is None:
            found = self._last[numbers] = self._made_last(numbers)
        return found

    def _made_last(self, numbers: Numbers) -> tuple[int, tuple[int, ...]]:
        free = self._free(self._part.everything)
        waiting = [
            each
            for number, each in enumerate(self.replacements)
            if numbers >> number & 1 and _at_most(each.old, each.new)
        ]
        backwards: list[Replacement] = []
        while (fitting := next((each for each in waiting if _at_most(each.old, free)), None)) is not None:
            waiting.remove(fitting)
            backwards.append(fitting)
            free = tuple(f + new - old for f, new, old in zip(free, fitting.new, fitting.old, strict=True))
        moves = (move for each in reversed(backwards) for move in each.moves())
        return sum(each.bits for each in backwards), tuple(moves)

    def split(self, move: int) -> tuple[int, ...]:
        """The sets of actions that make ``move``, which is one of the search's own or a whole replacement."""
        return next((each.moves() for each in self.replacements if each.bits == move), (move,))

    def _free(self, state: int) -> tuple[int, ...]:
        free = list(self._part.free)
        for bit, usage in self._timed:
            if state & bit:
                for resource, amount in enumerate(usage):
                    free[resource] -= amount
        return tuple(free)


def _own_exchanges(part: Part, bits: int) -> tuple[int, ...] | None:
    """The exchanges on topics on which only the role of ``bits`` has one attachment each to make and to undo.

    None if another role, or another attachment, has to do with one of its topics.
    """
    exchanges = []
    for topic in part.topics:
        both = topic.attach | topic.detach
        if both & bits:
            if both & ~bits or both.bit_count() != 2:
                return None
            exchanges.append(both)
    return tuple(exchanges)


def _found(part: Part, losses: PartLosses, bounds: RoleBounds) -> Iterator[Replacement]:
    for mask, *_ in losses.equivalent:
        timed = [bit for bit, op in enumerate(part.ops) if mask >> bit & 1 and op.port is None]
        exchanges = _own_exchanges(part, mask)
        replaced = next((each for each in bounds.replacements if mask & each.remove and mask & each.create), None)
        if replaced is None or exchanges is None or len(timed) != 2:
            continue
        if mask & ~(replaced.create | replaced.remove | sum(exchanges)):
            continue
        yield Replacement(mask, replaced.create, exchanges, replaced.remove, replaced.old, replaced.new, replaced.extra)


def _at_most(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    return all(a <= b for a, b in zip(one, other, strict=True))
