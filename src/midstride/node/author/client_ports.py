"""Clients of services and ROS actions: inputs that send requests.

A client that lacks its server, or a response, is an assumption that does not hold (docs/protocols/reflex.md).
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final

from midstride.errors import NodeError, Unanswered
from midstride.model.contract import Predicate, format_number
from midstride.model.wording import KIND_WORDS
from midstride.node.author.declared_contracts import REQUEST_OF, type_name
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Input, InputLink
from midstride.node.component_host import CalledService, Host
from midstride.wire.state import LinkState

# How long a server may be missing in the graph (s): one that has just been created is discovered later.
ABSENT: Final = 0.5
# The same where it has not been seen since the client was attached (s).
NEVER_SEEN: Final = 5.0
# How much longer than its bound a response may take (s): while state moves to a replacement, requests wait so long.
OVERDUE: Final = 2.0


class ClientLink(InputLink):
    """One attachment of a client."""

    __slots__ = ("service",)

    def __init__(self, client: ClientPort, topic: str, host: Host) -> None:
        super().__init__(client, topic, MessageTimes(host.now))
        self.endpoint = self.service = client.make(host, topic)


@dataclass(slots=True)
class _Call:
    """A request whose response is waited for. ``send`` sends it, and returns a future; None once it was sent."""

    future: Any
    service: CalledService
    bounded: bool  # the bound of the client holds for it
    since: int | None = None  # steady ns; None until it was sent
    mode: int = 0  # the number of the mode in which it was sent
    send: Callable[[], Any] | None = None
    response: Any = None  # the future that `send` has returned

    def pass_on(self, response: Any) -> None:
        """End the future as ``response`` has ended, which `send` had returned."""
        error, done = response.exception(), self.future.done()
        if error is not None and not done:
            self.future.set_exception(error)
        elif not done:
            self.future.set_result(response.result())

    def abandon(self, error: Exception) -> None:
        if self.response is not None:
            self.service.abandon(self.response, error)
        self.service.abandon(self.future, error)


class ClientPort(Input):
    """A client of a service. Created by ``Component.create_client``.

    It counts the responses that it has received, and having seen its server as one more.
    """

    kind: ClassVar = "srv"

    def __init__(self, name: str, type_: type, within: float | None) -> None:
        super().__init__(name, type_, Predicate(type_name(type_, kind=self.kind), within=within))
        self.within = within
        self._host: Host | None = None
        self._calls: dict[int, _Call] = {}  # by number, in order
        self._numbers = itertools.count()
        self._entered = 0  # how many modes have been entered
        self._seen = False
        self._there = False  # when it was looked last
        self._absent_since: int | None = None  # steady ns
        self._counted_from = 0  # what was waited for before does not count (steady ns)
        # Runs on the data thread as soon as that is free: until then, a response may wait there.
        self._probe: asyncio.Future[None] | None = None
        # Why it cannot be relied on, if so.
        self.gone: str | None = None

    def call_async(self, request: Any) -> Any:
        """Send ``request``, and return rclpy's future of the response: ``response = await client.call_async(request)``.

        Where the response does not come, since the server has gone or takes too long, the future ends with
        ``midstride.Unanswered``, and the functionality goes to a mode that does not assume the client
        (docs/protocols/reflex.md). An async mode need not catch that. A request waits here until the server has been
        discovered: ROS loses what is sent before. Call it on the thread of the modes. Raises NodeError while it is
        attached to no service, or if ``request`` is not of its type.
        """
        return self._send("call_async", request)

    def make(self, host: Host, name: str) -> CalledService:
        """Make its side of the service."""
        return host.create_client(name, self.type)

    def _send(self, method: str, request: Any, *more: Any) -> Any:
        what = REQUEST_OF[self.kind]
        if not isinstance(request, getattr(self.type, what)):
            words = f"client {self.name} takes {type_name(self.type, kind=self.kind)}, not {type(request).__name__}"
            raise NodeError(f"{words}; write {self.name}.{method}({self.type.__name__}.{what}(…))")
        link = next((link for link in self.links if isinstance(link, ClientLink)), None)
        if link is None:
            raise NodeError(f"client {self.name} is attached to no service; call it in a mode that assumes it")
        send = partial(link.service.call, request, *more)
        if self._waits or not link.service.matched():
            return self._awaited(link, _Call(link.service.unsent(), link.service, True, send=send))
        return self._sent(link, send())

    def _sent(self, link: ClientLink, future: Any, bounded: bool = True) -> Any:
        assert self._host is not None
        return self._awaited(link, _Call(future, link.service, bounded, self._host.steady(), self._entered))

    def _awaited(self, link: ClientLink, call: _Call) -> Any:
        """Note ``call``, and return its future."""
        number = next(self._numbers)
        self._calls[number] = call

        def done(_: Any) -> None:
            if self._calls.pop(number, None) is not None:
                link.count += 1

        call.future.add_done_callback(done)
        return call.future

    @property
    def _waits(self) -> bool:
        """Return whether a request waits for the server to be discovered."""
        return any(call.send is not None for call in list(self._calls.values()))

    def _send_waiting(self, host: Host) -> None:
        """Send, in order, what has waited for the server to be discovered. On the data thread."""
        for call in list(self._calls.values()):
            if call.send is not None:
                call.response, call.send, call.since, call.mode = call.send(), None, host.steady(), self._entered
                call.response.add_done_callback(call.pass_on)

    @property
    def ready(self) -> bool:
        """Return whether the server of the client is in the graph."""
        return any(link.endpoint.matched() > 0 for link in self.links)

    @property
    def denied(self) -> bool:
        return self.gone is not None

    @property
    def count(self) -> int:
        return sum(link.count for link in self.links) + self._seen

    def begin(self, host: Host) -> None:
        """Note that it has been attached, on ``host``."""
        self._host, self._seen, self._there = host, False, False
        self.restart()

    def enter_mode(self) -> None:
        """Note that a mode has been entered: a request that was sent before says nothing about it. Data thread."""
        self._entered += 1

    def restart(self) -> None:
        """A mode has been entered: what was wrong before does not count. Control thread."""
        self._absent_since = self.gone = None

    def pardon(self) -> None:
        """Note that the process has been stopped: the time so far does not count."""
        self._absent_since = None
        if self._host is not None:
            self._counted_from = self._host.steady()

    def look(self) -> None:
        """Look whether its server is there and answers. Control thread."""
        if (host := self._host) is None or not self.links:
            return
        now = host.steady()
        self.gone = self._why_absent(now)
        late = {} if self.gone is not None else self._late(host, now)
        if counts := [call for call in late.values() if call.mode == self._entered]:
            self.gone = self._why_late(counts[0], now)
        if self.gone is not None and self._calls:
            host.on_data(self._end_calls)
        elif late:  # they were sent in an earlier mode
            host.on_data(partial(self._end_calls, {number: self._why_late(call, now) for number, call in late.items()}))
        elif self._there and self._waits:
            host.on_data(partial(self._send_waiting, host))

    def _why_absent(self, now: int) -> str | None:
        names = ", ".join(link.topic for link in self.links)
        self._there = self.ready
        if self._there:
            self._seen, self._absent_since = True, None
        elif self._absent_since is None:
            self._absent_since = now
        absent = 0.0 if self._absent_since is None else (now - self._absent_since) / 1e9
        if absent > (ABSENT if self._seen else NEVER_SEEN):
            return f"client {self.name}: {names} has had no server for {absent:.2g} s"
        return None

    def _late(self, host: Host, now: int) -> dict[int, _Call]:
        """Return the requests, by number, that have waited for too long, unless a response waits for the thread."""
        limit = math.inf if self.within is None else self.within + OVERDUE
        calls = list(self._calls.items())
        late = {number: call for number, call in calls if call.bounded and self._waited(call, now) > limit}
        if not late:
            self._probe = None
            return {}
        if self._probe is None:
            self._probe = asyncio.ensure_future(host.on_data(lambda: None))
        return late if self._probe.done() else {}

    def _waited(self, call: _Call, now: int) -> float:
        """For how long (s) ``call`` has waited for its response, since it was sent."""
        return 0.0 if call.since is None else (now - max(call.since, self._counted_from)) / 1e9

    def _why_late(self, call: _Call, now: int) -> str:
        assert self.within is not None
        names = ", ".join(link.topic for link in self.links)
        bound = f"a response within {format_number(self.within)} s is assumed"
        waited = f"{self._waited(call, now):.2g} s"
        return f"client {self.name}: a request to {names} has not been answered for {waited} ({bound})"

    def remove(self, link: InputLink) -> None:
        self._end_calls()
        super().remove(link)

    def _end_calls(self, late: Mapping[int, str] | None = None) -> None:
        """End all requests, or those that are ``late``, by number, with the words why. Data thread."""
        why = self.gone or f"client {self.name} was detached"
        for number, words in (dict.fromkeys(self._calls, why) if late is None else late).items():
            if (call := self._calls.pop(number, None)) is not None:
                call.abandon(Unanswered(words))

    def states(self) -> dict[str, LinkState]:
        return {link.topic: LinkState(gate=None, count=0) for link in self.links}

    def __repr__(self) -> str:
        return f"<{KIND_WORDS[self.assumption.kind].input} {self.name}: {self.assumption}>"


class ActionClientPort(ClientPort):
    """A client of a ROS action. Created by ``Component.create_action_client``."""

    kind: ClassVar = "action"

    def make(self, host: Host, name: str) -> CalledService:
        return host.create_action_client(name, self.type, self._note_accepted)

    def send_goal_async(self, goal: Any, feedback_callback: Callable[[Any], object] | None = None) -> Any:
        """Send ``goal``, and return rclpy's future of its handle: as rclpy's action client does.

        It ends with ``midstride.Unanswered`` where the server has gone, or accepts or rejects the goal later than the
        bound allows; so does that of ``handle.get_result_async()`` where the server has gone. Raises NodeError while it
        is attached to no ROS action, or if ``goal`` is not of its type.
        """
        return self._send("send_goal_async", goal, feedback_callback)

    def _note_accepted(self, handle: Any) -> None:
        """Have the result of an accepted goal end with its server. Called before anyone else has the handle."""
        get_result = handle.get_result_async
        link = next((link for link in self.links if isinstance(link, ClientLink)), None)
        if link is not None:
            handle.get_result_async = lambda: self._sent(link, get_result(), bounded=False)

    def call_async(self, request: Any) -> Any:
        """Raises NodeError: a ROS action has goals."""
        raise NodeError(f"action client {self.name} sends goals; write {self.name}.send_goal_async(…)")
