"""The admission of requests to a component's services: which instance of a role handles which request.

Every server of a service receives every request (on ROS 2, where the instances of a role have one node name). Of two
instances one answers, and its admission is open. The other one holds what arrives until it answers: it is given the
requests that its predecessor has handled, handles the rest, and so each request is handled exactly once. While the
state of the one that answers moves to the other, neither answers, and both hold what arrives.

A client that has not discovered the successor yet sends its requests to the predecessor alone, which no longer handles
them: what it has held for a while it passes on to the successor, if that has not received it, and it returns the
response.

What is asked about a goal of a ROS action is handled by the instance that has accepted the goal, whether or not that
answers all else.
"""

from __future__ import annotations

import inspect
import itertools
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

from midstride.node.accepted_goals import Goals
from midstride.node.served_times import ServedTimes
from midstride.node.shared_requests import BEFORE, SharedRequests

# For how long (s) a request is held while admission is closed, and how many at most: a predecessor that answers has
# done so by then.
HOLD: Final = 5.0
HELD: Final = 1000
# For how long (s) a handled request is remembered, and how many at most: longer than any peer may hold it, which counts
# from when its code has time for requests. That may be late: it still constructs its node, a call does not return, or
# its process is stopped.
REMEMBER: Final = 60.0
REMEMBERED: Final = 10 * HELD
# After how long (s) a request that is held is asked after at the successor: the two receive one request so far apart.
PASS_AFTER: Final = 0.2
# After how long (s) one that a successor without the API has not received is handled here all the same.
LEFT_OVER: Final = 0.3
# Requests about goals that look the same, of which one was handled by the predecessor and one is held here, are the
# same one if they came at most so far apart (s of the steady clock, which two processes of one machine share).
SAME: Final = 1.0
# Those about a goal of the predecessor are compared when that ends. Until then a process that starts may be late by so
# much (s).
SAME_GOAL: Final = 5.0
# Between the identity of a handled request about goals and when it came.
_CAME: Final = " @"


@dataclass(frozen=True)
class PassableRequest:
    """A request of ``service`` that another instance handles.

    ``data`` is its form on the way. ``respond``, on any thread, sends the response that comes back.
    """

    service: str
    data: Callable[[], bytes]
    respond: Callable[[bytes], object]


# Handles a request that was passed on: its identity, its data, and what is called with the response, or with None where
# the code of the service has raised. On any thread, and so is that.
PassedHandler: TypeAlias = Callable[[str, bytes, "Callable[[bytes | None], object]"], None]


class GoalTurn(Enum):
    """The turn of an instance with a request about goals, by the rule of ``turn_of`` in foreign/gate/goals.h.

    ADD: it cancels its own goals, and leaves the list of them for the instance that answers.
    """

    WAIT = 0
    ANSWER = 1
    ADD = 2


class _Held(NamedTuple):
    """A request that is held since ``since`` (steady ns). ``asks_for``: the goal that it asks for; ``about``: the one
    that it is about, empty where that is many. None: none. ``service``: which one it is to, where that is timed."""

    request: str
    since: int
    handle: Callable[[], object]
    passable: PassableRequest | None = None
    asks_for: str | None = None
    about: str | None = None
    service: str = ""


class RequestAdmission:
    """Open, paused or closed. ``steady`` is the steady clock (ns). May be used on any thread: services run on two.

    ``yields`` counts how often another instance has asked to answer instead.
    """

    def __init__(self, steady: Callable[[], int], *, is_open: bool = True) -> None:
        self.is_open = is_open
        self._steady = steady
        self._lock = threading.Lock()
        # In order of arrival, when each request was handled; and those that are held. Those about goals may have equal
        # identities, so they are held under another name.
        self._handled: OrderedDict[str, int] = OrderedDict()
        self._held: OrderedDict[str, _Held] = OrderedDict()
        self._names = itertools.count()
        self.goals = Goals()
        # By goal of the predecessor, as long as that answers for it: the requests about it that have arrived here.
        self._left: dict[str, list[_Held]] = {}
        self.passed_handlers: dict[str, PassedHandler] = {}  # by the full name of the service
        self._unfinished: dict[str, str | None] = {}  # with the goals that they ask for
        # By the full name of a service or ROS action with a bound: how long its requests take.
        self.timed: dict[str, ServedTimes] = {}
        self._timed: dict[str, ServedTimes] = {}  # by request that is being handled
        self._answered: int | None = None  # when the last request was handled to the end
        self._paused = False
        self.yields = 0
        # Where a node without the API has the same services: which of the two answers, and what is claimed.
        self.shared: SharedRequests | None = None
        self._claimed: set[str] = set()  # of the requests that are being handled, those that were claimed there

    def admit(
        self,
        request: str,
        later: Callable[[], object],
        passable: PassableRequest | None = None,
        asks_for: str | None = None,
        service: str = "",
        waited: float = 0.0,
    ) -> bool:
        """Return whether to handle ``request`` now.

        Else ``later`` is called if admission opens before a peer has handled it.

        ``passable``: how it is passed on to a successor that has not received it; None where it cannot be.
        ``asks_for``: the goal that it asks for. ``request`` identifies it: the same for every server that receives it,
        and unique among all requests. ``service``: the full name of the service or ROS action that it is to;
        ``waited``: for how long the middleware has had it (s). Call :meth:`finished` once it has been handled, now or
        later.
        """
        now = self._steady()
        with self._lock:
            if request in self._handled:
                return False
            if self.shared is not None and asks_for is None:
                admitted = self._claims(self.shared, request, service, waited)
                if admitted is None:
                    self._held[request] = _Held(request, now, later, passable, service=service)
                self._forget_old(now)
                return bool(admitted)
            if self.is_open:
                self._handled[request] = now
                self._begin(request, service, asks_for, waited)
            else:
                self._held[request] = _Held(request, now, later, passable, asks_for, service=service)
            self._forget_old(now)
            return self.is_open

    def _claims(self, shared: SharedRequests, request: str, service: str, waited: float) -> bool | None:
        """Return whether to handle ``request``, or the other one has; None where it is held. With the lock."""
        if self._paused or not shared.answers():
            shared.note_held(request)
            return None
        return self._claim(shared, request, service, waited)

    def _claim(self, shared: SharedRequests, request: str, service: str, waited: float = 0.0) -> bool:
        if not shared.claim(request):
            return False
        self._handled[request] = self._steady()
        self._claimed.add(request)
        self._begin(request, service, waited=waited)
        return True

    def share(self, shared: SharedRequests) -> None:
        """Claim each request to a service from now on, and answer when ``shared`` says so. Call :meth:`look` often."""
        with self._lock:
            self.shared = shared
            for request in filter(_is_to_a_service, self._unfinished):  # which the other one waits for
                if shared.claim(request):
                    self._claimed.add(request)
            for request in list(self._handled)[-BEFORE:]:
                if _is_to_a_service(request) and request not in self._claimed:
                    shared.note_claimed(request)
            for request, held in self._held.items():
                if self._is_shared(held):
                    shared.note_held(request)
            shared.has_noted()

    def _is_shared(self, held: _Held) -> bool:
        """Return whether it is claimed before it is handled, by :meth:`look`."""
        return self.shared is not None and held.about is None and held.asks_for is None

    def share_no_longer(self) -> None:
        with self._lock:
            self.shared = None
            self._claimed.clear()

    def look(self) -> bool:
        """Handle what is held and is to be handled here now; whether admission has been opened or closed.

        That is each request that the other one has not claimed, once this one answers; or, once the other one does,
        what that has not received.
        """
        due = []
        with self._lock:
            if (shared := self.shared) is None:
                return False
            answers, now = not self._paused and shared.answers(), self._steady()
            left = not answers and shared.answered_before()
            for request, held in list(self._held.items()):
                if not self._is_shared(held):
                    continue
                overdue = left and now - held.since > LEFT_OVER * 1e9 and not shared.held_by_other(request)
                if answers or overdue or shared.claimed(request):
                    del self._held[request]
                    if (answers or overdue) and self._claim(shared, request, held.service):
                        due.append(held)
            self._forget_old(now)
            changed = answers != self.is_open
        for held in due:
            held.handle()
        if changed and answers:
            self.open(())
        elif changed:
            self.close()
        return changed

    def _begin(self, request: str, service: str, asks_for: str | None = None, waited: float = 0.0) -> None:
        """Note that ``request`` is being handled from now on. With the lock."""
        self._unfinished[request] = asks_for
        if (times := self.timed.get(service)) is not None:
            self._timed[request] = times
            times.came(request, waited)

    def handle(
        self,
        request: str,
        serve: Callable[[], Any],
        respond: Callable[[Any], object],
        later: Callable[[Callable[[], Any]], object],
    ) -> None:
        """Call ``serve`` for a ``request`` that was admitted, and ``respond`` with its result: None where it raises.

        The result may be an awaitable. ``later`` has the data thread call a function, or drive it where it is async.
        """
        awaited, result = False, None
        try:
            result = serve()
            awaited = inspect.isawaitable(result)
        finally:
            if not awaited:
                self._answer(request, result, respond)
        if awaited:
            later(partial(self._finish, request, result, respond))

    async def _finish(self, request: str, awaitable: Any, respond: Callable[[Any], object]) -> None:
        result = None
        try:
            result = await awaitable
        finally:
            self._answer(request, result, respond)

    def _answer(self, request: str, result: Any, respond: Callable[[Any], object]) -> None:
        try:
            respond(result)
        finally:
            self.finished(request)

    def goal_turn(self, request: str, about: str, later: Callable[[], object]) -> GoalTurn:
        """Whose turn it is with a request about the goal ``about``, or, where that is empty, to cancel many goals.

        Where this instance waits, ``later`` is called once it may be its turn; it then asks again. ``request``
        identifies it, as for :meth:`admit`, but those of two clients may have one identity. After ANSWER, call
        :meth:`finished` once it has been handled.
        """
        now = self._steady()
        with self._lock:
            came = f"{request}{_CAME}{now}"
            if about and self.goals.has(about):
                self.goals.asked(about, came)
                return GoalTurn.ANSWER
            if about in self._left:
                self._left[about].append(_Held(request, now, later, about=about))
                return GoalTurn.WAIT
            if self.is_open:
                self._handled[came] = now
                self._unfinished[request] = None
                return GoalTurn.ANSWER
            if not (about or self._paused) and self.goals.has_any:
                return GoalTurn.ADD
            self._held[f"{request} {next(self._names)}"] = _Held(request, now, later, about=about)
            self._forget_old(now)
            return GoalTurn.WAIT

    @property
    def predecessor_has_goals(self) -> bool:
        """Return whether the predecessor still answers for goals that it has accepted."""
        return bool(self._left)

    def predecessor_ended(self, results: Mapping[str, bytes] | None, handled: Iterable[str] = ()) -> None:
        """Answer from now on what is asked about the goals of the predecessor, also what only this one has received.

        ``results``: those that no client has fetched, by goal. None: it has ended without a word, and its goals are not
        known any more. ``handled``: the requests about them that it has handled.
        """
        with self._lock:
            left, self._left = self._left, {}
            if results is not None:
                self.goals.keep(results)
        waiting = [held for of_goal in left.values() for held in of_goal]
        for held in _not_handled(waiting, handled, SAME_GOAL):
            held.handle()

    def finished(self, request: str) -> None:
        """``request`` has been handled to the end, or its code has raised. Those about own goals do not count."""
        with self._lock:
            if request in self._unfinished:
                del self._unfinished[request]
                if request in self._claimed and self.shared is not None:
                    self._claimed.discard(request)
                    self.shared.answered()
                if (times := self._timed.pop(request, None)) is not None:
                    times.ended(request)
                self._answered = self._steady()

    def answered_within(self, seconds: float) -> bool:
        """Return whether a request was handled to the end within the last ``seconds``."""
        return self._answered is not None and self._steady() < self._answered + seconds * 1e9

    @property
    def busy(self) -> bool:
        """Return whether a request is being handled."""
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
                request: held.passable
                for request, held in self._held.items()
                if held.passable is not None and held.since <= before
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
            self._unfinished[request] = None
            return True

    def missing(self, requests: Iterable[str]) -> list[str]:
        """Return which of the ``requests`` have not arrived here."""
        with self._lock:
            return [each for each in requests if each not in self._handled and each not in self._held]

    def admit_passed(self, request: str, service: str = "") -> bool:
        """Return whether to handle a request to ``service`` that the predecessor passes on: unless it has arrived.

        If it arrives later, it is not handled again. Call :meth:`finished` as for others.
        """
        with self._lock:
            if request in self._handled or request in self._held:
                return False
            self._handled[request] = self._steady()
            self._begin(request, service)
            return True

    def _forget_old(self, now: int) -> None:
        handled, held = self._handled, self._held
        while handled and (len(handled) > REMEMBERED or now - next(iter(handled.values())) > REMEMBER * 1e9):
            handled.popitem(last=False)
        while held and (len(held) > HELD or (not self._paused and now - next(iter(held.values())).since > HOLD * 1e9)):
            held.popitem(last=False)

    def pause(self) -> bool:
        """Handle no further request until :meth:`open`; what arrives is held, however long. Whether it was open.

        That ends with :meth:`close` or :meth:`leave`, too: a successor has begun, or is about to.
        """
        with self._lock:
            was_open, self.is_open = self.is_open, False
            self._paused = self._paused or was_open
            return was_open

    def close(self) -> list[str]:
        """Handle no further request: another instance will. Returns the requests that were handled here lately."""
        with self._lock:
            self.yields += 1
            self.is_open = False
            self._end_pause()
            due = self._about_goals()
            handled = list(self._handled)
        for held in due:
            held.handle()
        return handled

    def give_goals(self) -> list[str]:
        """Return the goals that stay here once admission is closed, also those whose requests are being handled."""
        with self._lock:
            return self.goals.give(goal for goal in self._unfinished.values() if goal is not None)

    def leave(self) -> None:
        """Hold back no longer what is asked about goals that were accepted here: the state has moved without them."""
        with self._lock:
            self._end_pause()
            due = self._about_goals()
        for held in due:
            held.handle()

    def _end_pause(self) -> None:
        """Hold what is held for HOLD from now on: only now a successor can be asked whether it has it. With the lock.

        That has held it for HOLD at most, which may be less long than the pause.
        """
        if self._paused:
            self._paused, now = False, self._steady()
            self._held = OrderedDict((name, held._replace(since=now)) for name, held in self._held.items())

    @property
    def is_paused(self) -> bool:
        """Return whether no other instance can answer: this one is paused, and none has begun since."""
        return self._paused

    def _about_goals(self) -> list[_Held]:
        """Take what is held about goals: whose turn it is is asked again. With the lock."""
        due = [name for name, held in self._held.items() if held.about is not None]
        return [self._held.pop(name) for name in due]

    def open(self, handled: Iterable[str] | None, goals: Iterable[str] = ()) -> None:
        """Handle requests from now on, and those held that are not among ``handled``.

        ``handled`` None: the predecessor has exited without a reply, so what is held may have been handled; it is
        dropped, but for what is about goals, which are not known any more. ``goals``: those that the predecessor
        answers for until it ends.
        """
        now = self._steady()
        with self._lock:
            self._forget_old(now)
            known = dict.fromkeys(handled or ())
            about = _not_handled([held for held in self._held.values() if held.about is not None], known)
            due = [
                held
                for held in self._held.values()
                if (held in about if held.about is not None else handled is not None and held.request not in known)
                and not self._is_shared(held)
            ]
            self._held = OrderedDict((name, held) for name, held in self._held.items() if self._is_shared(held))
            self._left.update({goal: [] for goal in goals if goal not in self._left})
            for request in known:
                self._handled[request] = now
                self._handled.move_to_end(request)
            for held in due:
                if held.about is None:
                    self._handled[held.request] = now
                    self._begin(held.request, held.service, held.asks_for)
            self._forget_old(now)
            self.is_open, self._paused = True, False
        for held in due:
            held.handle()


def _is_to_a_service(request: str) -> bool:
    """Return whether ``request`` is no request for, or about, a goal."""
    return request[:1].isdecimal() or request[:1] == "-"


def _not_handled(held: Sequence[_Held], known: Iterable[str], within: float = SAME) -> list[_Held]:
    """Return which of the requests ``held`` about goals the predecessor has not handled, which has handled ``known``.

    One of each is the same where they came ``within`` so many seconds.

    Two clients' first requests look the same, as rclpy does not pass on whose they are. Where more of them are held
    than were handled at about the same time, all count: a client takes the first response, and one that got none
    would wait for ever.
    """
    came: dict[str, list[int]] = {}
    for request, _, at in (each.rpartition(_CAME) for each in known):
        if request:
            came.setdefault(request, []).append(int(at))

    def handled_near(each: _Held) -> int:
        return sum(abs(at - each.since) <= within * 1e9 for at in came.get(each.request, ()))

    def held_near(each: _Held) -> int:
        return sum(other.request == each.request and abs(other.since - each.since) <= within * 1e9 for other in held)

    return [each for each in held if held_near(each) > handled_near(each)]
