"""The admission of requests to a component's services: which instance of a role handles which request.

Every server of a service receives every request (on ROS 2, where the instances of a role have one node name). Of two
instances one answers, and its admission is open. The other one holds what arrives until it answers: it is given the
requests that its predecessor has handled, handles the rest, and so each request is handled exactly once. While the
state of the one that answers moves to the other, neither answers, and both hold what arrives.

A client that has not discovered the successor yet sends its requests to the predecessor alone, which no longer handles
them: what it has held for a while it passes on to the successor, if that has not received it, and it returns the
response.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias

# For how long (s) a request is held while admission is closed, and how many at most: a predecessor that answers has
# done so by then.
HOLD: Final = 5.0
HELD: Final = 1000
# For how long (s) a handled request is remembered, and how many at most: longer than any peer may hold it.
REMEMBER: Final = 2 * HOLD
REMEMBERED: Final = 10 * HELD
# After how long (s) a request that is held is asked after at the successor: the two receive one request so far apart.
PASS_AFTER: Final = 0.2


@dataclass(frozen=True)
class PassableRequest:
    """How a request of ``service`` is handled by another instance: ``data`` is its form on the way, and ``respond``,
    on any thread, sends the response that comes back."""

    service: str
    data: Callable[[], bytes]
    respond: Callable[[bytes], object]


# Handles a request that was passed on: its identity, its data, and what is called with the response, or with None where
# the code of the service has raised. On any thread, and so is that.
PassedHandler: TypeAlias = Callable[[str, bytes, "Callable[[bytes | None], object]"], None]


class RequestAdmission:
    """Open, paused or closed. ``steady`` is the steady clock (ns). May be used on any thread: services run on two.

    ``yields`` counts how often another instance has asked to answer instead.
    """

    def __init__(self, steady: Callable[[], int], *, is_open: bool = True) -> None:
        self.is_open = is_open
        self._steady = steady
        self._lock = threading.Lock()
        # By request, in order of arrival: when it was handled, or when it came and how to handle it.
        self._handled: OrderedDict[str, int] = OrderedDict()
        self._held: OrderedDict[str, tuple[int, Callable[[], object], PassableRequest | None]] = OrderedDict()
        self.passed_handlers: dict[str, PassedHandler] = {}  # by the full name of the service
        self._unfinished: set[str] = set()
        self._answered: int | None = None  # when the last request was handled to the end
        self._paused = False
        self.yields = 0

    def admit(self, request: str, later: Callable[[], object], passable: PassableRequest | None = None) -> bool:
        """Whether to handle ``request`` now. Else ``later`` is called if admission opens before a peer has handled it.

        ``passable``: how it is passed on to a successor that has not received it; None where it cannot be.
        ``request`` identifies it: the same for every server that receives it, and unique among all requests. Call
        :meth:`finished` once it has been handled, now or later.
        """
        now = self._steady()
        with self._lock:
            if request in self._handled:
                return False
            if self.is_open:
                self._handled[request] = now
                self._unfinished.add(request)
            else:
                self._held[request] = now, later, passable
            self._forget_old(now)
            return self.is_open

    def finished(self, request: str) -> None:
        """``request`` has been handled to the end, or its code has raised."""
        with self._lock:
            self._unfinished.discard(request)
            self._answered = self._steady()

    def answered_within(self, seconds: float) -> bool:
        """Return whether a request was handled to the end within the last ``seconds``."""
        return self._answered is not None and self._steady() < self._answered + seconds * 1e9

    @property
    def busy(self) -> bool:
        """Whether a request is being handled."""
        return bool(self._unfinished)

    @property
    def handled(self) -> list[str]:
        """The requests that were handled here lately."""
        with self._lock:
            return list(self._handled)

    def passable(self, held_for: float = 0.0) -> dict[str, PassableRequest]:
        """Return the requests that can be passed on, of those that have been held for so long (s)."""
        before = self._steady() - int(held_for * 1e9)
        with self._lock:
            return {
                request: passable
                for request, (since, _, passable) in self._held.items()
                if passable is not None and since <= before
            }

    def give_up(self, requests: Iterable[str]) -> None:
        """Hold these no longer: the successor has received them."""
        with self._lock:
            for request in requests:
                self._held.pop(request, None)

    def pass_on(self, request: str) -> bool:
        """Hold ``request`` no longer, since the successor is to handle it; call :meth:`finished` once it has.

        Returns False if it is not held any more.
        """
        with self._lock:
            if self._held.pop(request, None) is None:
                return False
            self._unfinished.add(request)
            return True

    def missing(self, requests: Iterable[str]) -> list[str]:
        """Return which of the ``requests`` have not arrived here."""
        with self._lock:
            return [each for each in requests if each not in self._handled and each not in self._held]

    def admit_passed(self, request: str) -> bool:
        """Return whether to handle a request that the predecessor passes on, which is so unless it has arrived.

        If it arrives later, it is not handled again. Call :meth:`finished` as for others.
        """
        with self._lock:
            if request in self._handled or request in self._held:
                return False
            self._handled[request] = self._steady()
            self._unfinished.add(request)
            return True

    def _forget_old(self, now: int) -> None:
        handled, held = self._handled, self._held
        while handled and (len(handled) > REMEMBERED or now - next(iter(handled.values())) > REMEMBER * 1e9):
            handled.popitem(last=False)
        while held and (len(held) > HELD or (not self._paused and now - next(iter(held.values()))[0] > HOLD * 1e9)):
            held.popitem(last=False)

    def pause(self) -> bool:
        """Handle no further request until :meth:`open`; what arrives is held, however long. Whether it was open."""
        with self._lock:
            was_open, self.is_open = self.is_open, False
            self._paused = self._paused or was_open
            return was_open

    def close(self) -> list[str]:
        """Handle no further request: another instance will. Returns the requests that were handled here lately."""
        with self._lock:
            self.yields += 1
            self.is_open = self._paused = False
            return list(self._handled)

    def open(self, handled: Iterable[str] | None) -> None:
        """Handle requests from now on, and those held that are not among ``handled``.

        ``handled`` None: the predecessor has exited without a reply, so what is held may have been handled; it is
        dropped.
        """
        now = self._steady()
        with self._lock:
            self._forget_old(now)
            due = {} if handled is None else {name: later for name, (_, later, _) in self._held.items()}
            self._held.clear()
            for request in handled or ():
                due.pop(request, None)
                self._handled[request] = now
                self._handled.move_to_end(request)
            self._handled.update(dict.fromkeys(due, now))
            self._unfinished.update(due)
            self._forget_old(now)
            self.is_open, self._paused = True, False
        for later in due.values():
            later()
