"""The gate before a component's services: which instance of a role handles which request.

Every server of a service receives every request (on ROS 2, where the instances of a role have one node name). Of two
instances one answers, and its gate is open. The other one holds what arrives until it is that one's turn: it is given
the requests that its predecessor has handled, handles the rest, and so each request is handled exactly once.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Final

# For how long (s) a closed gate holds a request, and how many at most: a predecessor that answers has done so by then.
HOLD: Final = 5.0
HELD: Final = 1000
# For how long (s) a handled request is remembered, and how many at most: longer than any peer may hold it.
REMEMBER: Final = 2 * HOLD
REMEMBERED: Final = 10 * HELD


class ServiceGate:
    """``steady`` is the steady clock (ns). May be used on any thread: services run on two."""

    def __init__(self, steady: Callable[[], int], *, is_open: bool = True) -> None:
        self.is_open = is_open
        self._steady = steady
        self._lock = threading.Lock()
        # By request, in order of arrival: when it was handled, or when it came and how to handle it.
        self._handled: OrderedDict[str, int] = OrderedDict()
        self._held: OrderedDict[str, tuple[int, Callable[[], object]]] = OrderedDict()

    def admit(self, request: str, later: Callable[[], object]) -> bool:
        """Whether to handle ``request`` now. Else ``later`` is called if the gate opens before a peer has handled it.

        ``request`` identifies it: the same for every server that receives it, and unique among all requests.
        """
        now = self._steady()
        with self._lock:
            if request in self._handled:
                return False
            if self.is_open:
                self._handled[request] = now
            else:
                self._held[request] = now, later
            self._forget_old(now)
            return self.is_open

    def _forget_old(self, now: int) -> None:
        handled, held = self._handled, self._held
        while handled and (len(handled) > REMEMBERED or now - next(iter(handled.values())) > REMEMBER * 1e9):
            handled.popitem(last=False)
        while held and (len(held) > HELD or now - next(iter(held.values()))[0] > HOLD * 1e9):
            held.popitem(last=False)

    def close(self) -> list[str]:
        """Handle no further request. Returns the requests that were handled here lately."""
        with self._lock:
            self.is_open = False
            return list(self._handled)

    def open(self, handled: Iterable[str] | None) -> None:
        """Handle requests from now on, and those held that are not among ``handled``.

        ``handled`` None: the predecessor has exited without a reply, so what is held may have been handled; it is
        dropped.
        """
        now = self._steady()
        with self._lock:
            self._forget_old(now)
            due = {} if handled is None else {name: later for name, (_, later) in self._held.items()}
            self._held.clear()
            for request in handled or ():
                due.pop(request, None)
                self._handled[request] = now
                self._handled.move_to_end(request)
            self._handled.update(dict.fromkeys(due, now))
            self._forget_old(now)
            self.is_open = True
        for later in due.values():
            later()
