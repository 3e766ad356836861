"""The goals of ROS actions that an instance has accepted, and what it answers for those of its predecessor.

A goal stays with the instance that has accepted it: what is asked about it is answered there, whichever instance
answers all else (docs/protocols/services.md). :mod:`.request_admission` says whose turn it is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias, TypeVar

from midstride.wire.state import GoalCounts

T = TypeVar("T")

# How many bytes the results of a predecessor have at most, in all, that no client had fetched.
KEPT_RESULTS: Final = 16 << 20
# How long a request to cancel many goals waits until the other instance has cancelled its own goals (s).
ADDING: Final = 1.0
# How many such lists are remembered at most: each is asked for within ADDING.
LISTS: Final = 16

# Called with the serialized response of the other instance to a request to cancel goals; with None if there is none.
ListTaker: TypeAlias = Callable[["bytes | None"], object]


@dataclass
class _Goal:
    """A goal that was accepted here. ``cancel_all`` has the goals of its server cancelled; on any thread.

    ``result``: the response with its result, serialized, once it has ended. ``fetched``: a client has asked for that.
    """

    cancel_all: Callable[[], object]
    result: Callable[[], bytes] | None = None
    fetched: bool = False


class Goals:
    """The goals of one instance, by UUID in hexadecimal. May be used on any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._own: dict[str, _Goal] = {}
        self._kept: dict[str, bytes] = {}
        self._fetched: set[str] = set()  # of those kept, the ones that a client has now
        self._asked: dict[str, list[str]] = {}  # by goal, the requests about it that were handled here
        self._handed_over = False
        self._given: frozenset[str] = frozenset()
        self._accepted = self._ended = self._cancelled = self._unknown = 0
        # Requests to cancel many goals: what the other instance has cancelled, what waits for that, and what was
        # cancelled here. In order of arrival, as the requests of two clients may have one identity.
        self._lists: list[tuple[str, bytes]] = []
        self._takers: list[tuple[str, ListTaker]] = []
        self._to_send: list[tuple[str, bytes]] = []

    # -- what becomes of its goals -----------------------------------------------------------------

    def accepted(self, goal: str, cancel_all: Callable[[], object]) -> bool:
        """Note that ``goal`` was accepted here. Returns False if that was noted before, as its UUID was used twice."""
        with self._lock:
            if goal in self._own:
                return False
            self._own[goal] = _Goal(cancel_all)
            self._accepted += 1
            return True

    def ended(self, goal: str, result: Callable[[], bytes], *, cancelled: bool) -> None:
        with self._lock:
            if (found := self._own.get(goal)) is not None:
                found.result = result
            self._ended += not cancelled
            self._cancelled += cancelled

    def fetched(self, goal: str) -> None:
        """Note that a client has asked for the result of ``goal``; it gets it as soon as there is one."""
        with self._lock:
            if (found := self._own.get(goal)) is not None:
                found.fetched = True
            elif goal in self._kept:
                self._fetched.add(goal)

    def expired(self, goal: str) -> None:
        """Note that ROS has discarded the result of ``goal``."""
        with self._lock:
            self._own.pop(goal, None)
            if goal not in self._given:
                self._asked.pop(goal, None)

    def asked(self, goal: str, request: str) -> None:
        """Note that a ``request`` about ``goal`` is handled here; its words say which it is, and when it came."""
        with self._lock:
            self._asked.setdefault(goal, []).append(request)

    @property
    def requests(self) -> list[str]:
        """The requests about its goals that were handled here. Of a goal that has not ended, none has its result."""
        with self._lock:
            unended = {id for id, goal in self._own.items() if goal.result is None}
            return [each for goal, requests in self._asked.items() if goal not in unended for each in requests]

    def not_known(self) -> None:
        """Note that a request about a goal was answered that no instance knows."""
        with self._lock:
            self._unknown += 1

    @property
    def counts(self) -> GoalCounts | None:
        """Return what has become of all goals so far; None where there has been none."""
        found = GoalCounts(accepted=self._accepted, ended=self._ended, cancelled=self._cancelled, unknown=self._unknown)
        return found if found != GoalCounts() else None

    # -- whose a goal is ---------------------------------------------------------------------------

    def has(self, goal: str) -> bool:
        """Return whether requests about ``goal`` are answered here, as it was accepted here."""
        return (goal in self._own or goal in self._given) and not self._handed_over

    @property
    def has_any(self) -> bool:
        """Return whether there is a goal about which requests are answered here."""
        return bool(self._own or self._given) and not self._handed_over

    def give(self, asked: Iterable[str]) -> list[str]:
        """Return the goals that stay here while another instance answers, with those that are ``asked`` for just now.

        Those of predecessors whose results are kept here are among them. That instance leaves to this one what is asked
        about them, also where ROS has discarded them meanwhile.
        """
        with self._lock:
            self._given = frozenset() if self._handed_over else frozenset((*self._own, *self._kept, *asked))
            self._asked = {goal: requests for goal, requests in self._asked.items() if self.has(goal)}
            return sorted(self._given)

    @property
    def in_progress(self) -> int:
        with self._lock:
            return sum(goal.result is None for goal in self._own.values())

    def cancel(self) -> None:
        """Have all goals in progress cancelled, as a client would."""
        with self._lock:
            found = {id(goal.cancel_all): goal.cancel_all for goal in self._own.values() if goal.result is None}
        for cancel_all in found.values():
            cancel_all()

    # -- results that no client has fetched --------------------------------------------------------

    def hand_over(self) -> dict[str, bytes]:
        """Answer nothing about goals from now on. Returns the results that no client has fetched, serialized.

        Those that predecessors had left are among them.
        """
        with self._lock:
            self._handed_over = True
            left = {id: goal.result for id, goal in self._own.items() if goal.result is not None and not goal.fetched}
            kept = {id: result for id, result in self._kept.items() if id not in self._fetched}
            return {**kept, **{goal: result() for goal, result in left.items()}}

    @property
    def handed_over(self) -> bool:
        """Return whether a successor answers what is asked about the goals that were accepted here."""
        return self._handed_over

    def keep(self, results: Mapping[str, bytes]) -> None:
        """Keep the results that a predecessor has handed over; the oldest are given up beyond KEPT_RESULTS."""
        with self._lock:
            self._kept.update(results)
            size = sum(map(len, self._kept.values()))
            for goal in list(self._kept):
                if size <= KEPT_RESULTS:
                    break
                size -= len(self._kept.pop(goal))

    def server_left(self, cancel_all: Callable[[], object]) -> None:
        """Keep the results that no client has fetched of a server that has left the graph.

        ``cancel_all`` is what :meth:`accepted` was given for its goals. Another server of its name may come, as where
        the port is detached and attached again.
        """
        with self._lock:
            ended = {
                id: (goal.result, goal.fetched)
                for id, goal in self._own.items()
                if goal.cancel_all == cancel_all and goal.result is not None
            }
            for goal in ended:
                del self._own[goal]
        self.keep({id: result() for id, (result, fetched) in ended.items() if not fetched})

    def kept(self, goal: str) -> bytes | None:
        """Return the response with the result of a goal whose server is gone, serialized; None where there is none.

        Such a goal was accepted by a predecessor, or by a server that has left the graph.
        """
        return self._kept.get(goal)

    # -- requests to cancel many goals -------------------------------------------------------------

    def add_list(self, request: str, response: bytes) -> None:
        """Leave what was cancelled here for ``request``, which the other instance answers."""
        with self._lock:
            self._to_send.append((request, response))

    def lists_to_send(self) -> list[tuple[str, bytes]]:
        """Take what :meth:`add_list` has left: requests, each with what was cancelled for it."""
        with self._lock:
            found, self._to_send = self._to_send, []
            return found

    def list_arrived(self, request: str, response: bytes) -> None:
        with self._lock:
            if (taker := _take_first(self._takers, request)) is None:
                self._lists.append((request, response))
                del self._lists[:-LISTS]
        if taker is not None:
            taker(response)

    def await_list(self, request: str, taker: ListTaker) -> None:
        """Have ``taker`` called with what the other instance has cancelled for ``request``, or with None after ADDING.

        It is called on any thread.
        """
        waiting = (request, taker)
        with self._lock:
            response = _take_first(self._lists, request)
            if response is None:
                self._takers.append(waiting)
        if response is not None:
            taker(response)
            return

        def give_up() -> None:
            with self._lock:
                late = any(each is waiting for each in self._takers)
                self._takers = [each for each in self._takers if each is not waiting]
            if late:
                taker(None)

        timer = threading.Timer(ADDING, give_up)
        timer.daemon = True
        timer.start()


def _take_first(found: list[tuple[str, T]], request: str) -> T | None:
    """Take the first of these that is for ``request``; None where there is none."""
    for place, (of, each) in enumerate(found):
        if of == request:
            del found[place]
            return each
    return None
