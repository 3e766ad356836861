"""The baton as a component sees it that hands over to a node without Midstride's API, or takes over from one.

The word of the baton is in shared memory (``foreign/gate/baton.h``), and every step is made by the library of the gate.
For the length of a hand-over the component has a *slot*: the part of one more node in that memory.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_int, c_uint32, c_uint64, c_void_p
from dataclasses import dataclass
from enum import IntEnum

from midstride.node.page_slot import PageSlot
from midstride.wire.replies import SharedSlotPlace


class BatonState(IntEnum):
    HELD = 0
    OFFERED = 1
    FENCED = 2


class BatonStep(IntEnum):
    """The steps with a baton besides publishing (``baton_*`` in baton.h)."""

    NAME_SUCCESSOR = 0
    WITHDRAW = 1
    SETTLE = 2
    FENCE = 3
    LIFT = 4
    GIVE = 5
    TAKE = 6


@dataclass(frozen=True, slots=True)
class BatonWord:
    """The fields of the word of a baton. Nodes are their index + 1, 0 for none."""

    writers: int
    state: BatonState
    holder: int
    successor: int
    predecessor: int
    generation: int

    @classmethod
    def of(cls, word: int) -> BatonWord:
        return cls(
            word & 0xFF,
            BatonState(word >> 8 & 0xF),
            word >> 12 & 0xFFF,
            word >> 24 & 0xFFF,
            word >> 36 & 0xFFF,
            word >> 48,
        )


class SharedSlot(PageSlot):
    """The slot of one hand-over, which decides it (:class:`midstride.node.handover.arbiter.Arbiter`).

    Made by joining. Raises CommandRefused where the page of the gates cannot be used. ``me`` and ``other`` are as in
    the word.
    """

    def __init__(self, place: SharedSlotPlace) -> None:
        super().__init__(place)
        self._word = self._library.midstride_baton(self._slot, place.baton)
        self.me, self.other, self.timed = place.index + 1, place.other + 1, place.timed

    def _declare(self, library: ctypes.PyDLL) -> None:
        library.midstride_begin.argtypes = [c_void_p, c_uint32]
        library.midstride_end.argtypes, library.midstride_end.restype = [c_void_p], None
        library.midstride_baton.argtypes, library.midstride_baton.restype = [c_void_p, c_uint32], POINTER(c_uint64)
        library.midstride_take_step.argtypes = [POINTER(c_uint64), c_int, c_uint32, c_uint32, c_int]

    def begin(self, output: int) -> bool:
        return self._slot is not None and bool(self._library.midstride_begin(self._slot, output))

    def end(self) -> None:
        self._library.midstride_end(self._slot)

    def word(self) -> BatonWord:
        return BatonWord.of(self._word[0])

    def step(self, step: BatonStep, node: int, successor: int = 0, *, at_once: bool = False) -> BatonWord:
        """Take ``step``, where it is possible; the word afterwards."""
        self._library.midstride_take_step(self._word, step, node, successor, at_once)
        return self.word()

    def admits(self) -> bool:
        word = self.word()
        return word.holder == self.me or (word.successor == self.me and word.state is BatonState.OFFERED)

    def request(self) -> None:
        self.step(BatonStep.NAME_SUCCESSOR, self.other, self.me, at_once=self.timed)

    @property
    def refused(self) -> bool:
        """The offer is withdrawn, or the baton was taken from the old side by force."""
        word = self.word()
        return word.holder == self.other and not word.successor

    def renounce(self) -> bool:
        return self.step(BatonStep.WITHDRAW, self.other).holder != self.me

    def give_back(self) -> None:
        if self._slot is not None:
            if not self.renounce():
                self.step(BatonStep.GIVE, self.other)
            self.leave()

    @property
    def settled(self) -> bool:
        """Until it is, the old side gets the baton back if this one dies."""
        word = self.word()
        return self._slot is None or word.holder != self.me or not word.predecessor

    @property
    def passed_on(self) -> bool:
        return self._slot is not None and self.word().holder != self.me

    is_overtaken = passed_on

    undecided = False

    def share(self, place: str) -> None:
        """The word says it."""

    def free(self) -> None:
        """The word says it."""

    def reclaim(self) -> bool:
        return self._slot is None or self.step(BatonStep.FENCE, self.me).holder == self.me

    def reclaim_freed(self) -> bool:
        return not self.passed_on and self.reclaim()

    def leave(self) -> None:
        if self._slot is None:
            return
        word = self.word()
        if word.predecessor == self.me:  # for good: the new side keeps the baton even if it dies
            self.step(BatonStep.SETTLE, word.holder)
        super().leave()
