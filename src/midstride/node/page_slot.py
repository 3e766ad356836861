"""A slot of a component: the part that it has in the page of the gates, which it shares with a node without the API."""

from __future__ import annotations

import ctypes
from ctypes import c_char_p, c_uint32, c_void_p

from midstride.errors import CommandRefused
from midstride.wire.replies import PagePlace


class PageSlot:
    """Made by joining. Raises CommandRefused where the page of the gates cannot be used."""

    def __init__(self, place: PagePlace) -> None:
        try:
            # Its calls are short, and keep the interpreter's lock.
            self._library = library = ctypes.PyDLL(place.library)
            library.midstride_join.argtypes, library.midstride_join.restype = [c_char_p, c_uint32], c_void_p
            library.midstride_leave_slot.argtypes, library.midstride_leave_slot.restype = [c_void_p], None
            self._declare(library)
        except (OSError, AttributeError) as error:
            raise CommandRefused(f"the library of the gate cannot be used: {error}") from None
        self._slot: int | None = library.midstride_join(place.page.encode(), place.index)
        if self._slot is None:
            raise CommandRefused(f"the page of the gates, {place.page}, cannot be used, or has another layout")

    def _declare(self, library: ctypes.PyDLL) -> None:
        """State the types of the functions that are called."""

    def leave(self) -> None:
        """Give the part up. Does nothing where that has been done."""
        slot, self._slot = self._slot, None
        if slot is not None:
            self._library.midstride_leave_slot(slot)
