"""The requests to a component's services as it shares them with a node that has the library of the gate instead.

Both claim each request in shared memory before they handle it (``foreign/gate/known.c``), and a word there says which
of the two answers (``foreign/gate/requests.h``). The component has a *slot* there: the part of one more node.
"""

from __future__ import annotations

import ctypes
import time
from ctypes import c_char_p, c_int64, c_void_p
from typing import Final, Protocol

from midstride.node.page_slot import PageSlot
from midstride.wire.replies import PagePlace

# How many of the requests that it has handled before are claimed when it joins: fewer than the page has places for.
BEFORE: Final = 3000


class SharedRequests(Protocol):
    """A ``request`` is identified by "when its client has sent it" and its number
    (:mod:`midstride.backends.ros2.component.admitting_node`)."""

    def answers(self) -> bool:
        """Return whether this component answers what arrives now."""
        ...

    def answered_before(self) -> bool:
        """Return whether it has answered before the other one, which does now."""
        ...

    def claim(self, request: str) -> bool:
        """Claim it; whether the other one has not. Call :meth:`answered` once it has been handled."""
        ...

    def note_claimed(self, request: str) -> None:
        """Note that it was handled here before the requests were shared."""
        ...

    def note_held(self, request: str) -> None:
        """Note that it has arrived here, and is held."""
        ...

    def has_noted(self) -> None:
        """Note that all is noted that was handled here before: if this component dies, it has handled no more."""
        ...

    def claimed(self, request: str) -> bool: ...

    def held_by_other(self, request: str) -> bool: ...

    def answered(self) -> None: ...


class RequestsSlot(PageSlot):
    """Implements SharedRequests by the functions of the library.

    May be used on any thread; left only when no other one uses it.
    """

    def __init__(self, place: PagePlace) -> None:
        super().__init__(place)
        self.place = place
        self._served: set[str] = set()

    def _declare(self, library: ctypes.PyDLL) -> None:
        library.midstride_serve.argtypes = [c_void_p, c_char_p]
        for name in ("answers", "answered_before", "answered", "left_before", "is_alone", "has_noted"):
            getattr(library, f"midstride_{name}").argtypes = [c_void_p]
        for name in ("claim_request", "note_claimed", "note_arrived", "known"):
            getattr(library, f"midstride_{name}").argtypes = [c_void_p, c_int64, c_int64]
        library.midstride_answer.argtypes = [c_void_p, c_int64]

    def serve(self, services: set[str]) -> None:
        """Say that the component has these services (full names); the other one answers at once what only it has."""
        for name in services - self._served if self._slot is not None else ():
            self._served.add(name)
            self._library.midstride_serve(self._slot, name.encode())

    def _call(self, name: str, *arguments: int, left: int = 0) -> int:
        """Call the function; ``left``: the result once it shares them no longer."""
        return left if self._slot is None else int(getattr(self._library, f"midstride_{name}")(self._slot, *arguments))

    def answers(self) -> bool:
        return bool(self._call("answers", left=1))

    def answered_before(self) -> bool:
        return bool(self._call("answered_before"))

    def claim(self, request: str) -> bool:
        return bool(self._call("claim_request", *_of(request), left=1))

    def note_claimed(self, request: str) -> None:
        self._call("note_claimed", *_of(request))

    def note_held(self, request: str) -> None:
        self._call("note_arrived", *_of(request))

    def has_noted(self) -> None:
        self._call("has_noted")

    def claimed(self, request: str) -> bool:
        return self._call("known", *_of(request)) == 1

    def held_by_other(self, request: str) -> bool:
        return self._call("known", *_of(request)) == 2

    def answered(self) -> None:
        self._call("answered")

    def answer(self, drain: float) -> None:
        """Answer from now on; the other one has ``drain`` (s) for what it has taken."""
        self._call("answer", time.monotonic_ns() + int(drain * 1e9))

    @property
    def left_before(self) -> int:
        """The number of requests that the other one has taken, and not answered, that answered before."""
        return self._call("left_before")

    @property
    def is_alone(self) -> bool:
        """Return whether the other one has ended."""
        return bool(self._call("is_alone", left=1))


def _of(request: str) -> tuple[int, int]:
    sent, _, number = request.partition(" ")
    return int(sent), int(number)
