"""The baton as a component sees it that hands over to a node without Midstride's API, or takes over from one.

The word of the baton is in shared memory (``foreign/baton.h``), and every step is made by the library of the gate. For
the length of a hand-over the component has a *seat*: the part of one more node in that memory.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_uint32, c_uint64, c_void_p
from dataclasses import dataclass
from enum import IntEnum

from midstride.errors import CommandRefused
from midstride.wire.replies import Seat


class BatonState(IntEnum):
    HELD = 0
    LAID = 1
    FENCED = 2


class BatonStep(IntEnum):
    """What is done with a baton besides publishing (``baton_*`` in baton.h)."""

    NAME_SUCCESSOR = 0
    WITHDRAW = 1
    SETTLE = 2
    FENCE = 3
    LIFT = 4
    GIVE = 5


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


class TakenSeat:
    """The seat of one hand-over. ``me`` and ``other`` are as in the word. Raises CommandRefused where it is not there.

    :meth:`begin` and :meth:`end` are for the data thread, the others for the control thread.
    """

    def __init__(self, seat: Seat) -> None:
        try:
            # Its calls are short, and keep the interpreter's lock.
            self._library = library = ctypes.PyDLL(seat.library)
            library.midstride_sit.argtypes, library.midstride_sit.restype = [c_char_p, c_uint32], c_void_p
            library.midstride_rise.argtypes, library.midstride_rise.restype = [c_void_p], None
            library.midstride_begin.argtypes = [c_void_p, c_uint32]
            library.midstride_end.argtypes, library.midstride_end.restype = [c_void_p], None
            library.midstride_baton.argtypes, library.midstride_baton.restype = [c_void_p, c_uint32], POINTER(c_uint64)
            library.midstride_take_step.argtypes = [POINTER(c_uint64), c_int, c_uint32, c_uint32, c_int]
        except (OSError, AttributeError) as error:
            raise CommandRefused(f"the library of the gate cannot be used: {error}") from None
        self._seat: int | None = library.midstride_sit(seat.page.encode(), seat.index)
        if self._seat is None:
            raise CommandRefused(f"the page of the gates, {seat.page}, cannot be used")
        self._word = library.midstride_baton(self._seat, seat.baton)
        self.me, self.other, self.timed = seat.index + 1, seat.other + 1, seat.timed

    def begin(self, port: int) -> bool:
        """Whether a message may be published on a port now; if so, :meth:`end` must follow."""
        return self._seat is not None and bool(self._library.midstride_begin(self._seat, port))

    def end(self) -> None:
        self._library.midstride_end(self._seat)

    def word(self) -> BatonWord:
        return BatonWord.of(self._word[0])

    def step(self, step: BatonStep, node: int, successor: int = 0, *, at_once: bool = False) -> BatonWord:
        """Take ``step``, where it is possible; the word afterwards."""
        self._library.midstride_take_step(self._word, step, node, successor, at_once)
        return self.word()

    def rise(self) -> None:
        """Give the seat back. Nothing else of this object may be used afterwards."""
        if self._seat is not None:
            self._library.midstride_rise(self._seat)
            self._seat = None

    @property
    def taken(self) -> bool:
        return self._seat is not None
