"""Servers of services and ROS actions: outputs that answer requests.

A server has a service in the ROS graph while the mode of its functionality serves, and only then, unless it refuses in
the other modes. Which instance of a role answers a request is decided below, for all services of the node alike
(docs/protocols/services.md).
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from typing import Any, ClassVar, TypeAlias

from midstride.errors import NodeError
from midstride.model.contract import DEFAULT_QOS, Predicate, connector_kind
from midstride.model.wording import KIND_WORDS
from midstride.node.author.declared_contracts import Guarantee, type_name
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Output, OutputLink
from midstride.node.component_host import Host, ServedService
from midstride.node.control.response_watch import ResponseWatch
from midstride.node.served_times import ServedTimes, SlowerClock
from midstride.wire.state import GateState, LinkState, MeasuredResponses

#: ``function(request, response)`` fills the response, and returns it or None. It may be async.
RequestFunction: TypeAlias = Callable[[Any, Any], Any]


class _ServerEndpoint:
    """The service of a server under one name, which is in the graph while it is shown. On the data thread."""

    def __init__(self, make: Callable[[], ServedService]) -> None:
        self._make = make
        self._service: ServedService | None = None

    def show(self, shown: bool) -> None:
        if shown and self._service is None:
            self._service = self._make()
        elif not shown and self._service is not None:
            service, self._service = self._service, None
            service.retire()

    def publish(self, message: Any) -> None:
        raise NodeError("a server has no messages; its function answers requests")

    def matched(self) -> int:
        return 0  # clients are not counted

    def reader_ids(self) -> frozenset[str]:
        return frozenset()

    async def acknowledged(self, timeout: float) -> bool | None:
        return None

    def destroy(self) -> None:
        self.show(False)


class ServerLink(OutputLink):
    """One attachment of a server. Its gate is shown as open while its instance is the one that answers.

    ``watch``: whether it answers within the bound that the program states; None where that states none.
    """

    __slots__ = ("_answers", "_free_at", "_times", "service", "watch")

    def __init__(self, server: ServerPort, topic: str, host: Host) -> None:
        self.service = _ServerEndpoint(lambda: server.make(host, topic))
        super().__init__(server, topic, self.service, MessageTimes(host.now))
        self._answers = host.admission
        self._times: ServedTimes | None = None
        self._free_at = 0  # when the data thread was known to be free last, by the clock of the times
        self.watch: ResponseWatch | None = None
        if server.within is not None:
            clock = SlowerClock(host.steady, host.now, lambda: host.simulated_time)
            self._times = self._answers.timed[topic] = ServedTimes(clock)
            self._free_at = clock()
            self.watch = ResponseWatch(server.within)

    def look(self, beat: int, *, free: bool) -> None:
        """See how it answers. ``free``: the data thread has been free since the last look."""
        if self.watch is None or self._times is None:
            return
        now = self._times.clock()
        self._free_at = now if free else self._free_at
        self._times.busy = 0 if free else self._free_at
        self.watch.look(self._times if self.is_live else None, (0, 0), beat, now)

    def destroy(self) -> None:
        if self._times is not None and self._answers.timed.get(self.topic) is self._times:
            del self._answers.timed[self.topic]
        super().destroy()

    @property
    def lets_pass(self) -> bool:
        return not self.is_silenced and self._answers.is_open

    @property
    def is_live(self) -> bool:
        return self.open and self.lets_pass

    @property
    def gate(self) -> GateState:
        return "open" if self.is_live else "closed"


class ServerPort(Output):
    """A server of a service. Created by ``Component.create_server``."""

    kind: ClassVar = "srv"

    def __init__(
        self, name: str, type_: type, function: RequestFunction, within: float | None, refusal: RequestFunction | None
    ) -> None:
        super().__init__(name, type_, DEFAULT_QOS)
        self.function = function
        self.within = within
        self.refusal = refusal
        # Whether the mode of its functionality serves.
        self.serving = False
        self._beat = 0  # how often it was looked
        # Runs on the data thread as soon as that is free.
        self._probe: asyncio.Future[None] | None = None
        # Calls the function, once the component runs: the functionality degrades where it raises.
        self.call: Callable[[ServerPort, Any, Any], Any] = lambda server, request, response: None

    def guaranteed(self, promise: Guarantee) -> Predicate:
        return Predicate(type_name(self.type, kind=self.kind), within=self.within)

    def make(self, host: Host, name: str) -> ServedService:
        """Make its service, which is then in the graph."""
        return host.create_server(name, self.type, self.answer)

    @property
    def stays(self) -> bool:
        """Return whether the server is in the graph in modes that do not serve."""
        return self.refusal is not None

    def promise(self, guaranteed: Guarantee) -> None:
        """A server has no messages, so no rate and no fields."""

    def write(self, message: Any) -> None:
        """Raises NodeError: a server answers, and writes no messages."""
        raise NodeError(f"server {self.name} has no messages to write; its function answers requests")

    def serve(self, serving: bool) -> None:
        """Answer from now on, or not any more: then the service leaves the graph, unless the server refuses."""
        self.serving = serving
        for link in self.links:
            self.show(link)

    def show(self, link: OutputLink) -> None:
        if isinstance(link, ServerLink):
            link.service.show(self.serving or self.stays)

    def answer(self, request: Any, response: Any) -> Any:
        """The response, or an awaitable of it; None where there is none. On the data thread.

        A server that does not refuse answers what has arrived before it leaves the graph.
        """
        if self.serving or self.refusal is None:
            return self.call(self, request, response)
        return self.refuse(request, response)

    def refuse(self, request: Any, response: Any) -> Any:
        """The refusing response; None where the server does not refuse."""
        return None if self.refusal is None else self.fitted(self.refusal(request, response), response)

    def fitted(self, result: Any, response: Any) -> Any:
        """Return what a function has returned, or ``response`` where it has filled that. Raises NodeError."""
        if result is None:
            return response
        if not isinstance(result, type(response)):
            raise NodeError(
                f"the function of server {self.name} returned {result!r}; return the response that it was called with"
            )
        return result

    def look(self, host: Host) -> None:
        """Look whether it answers within its bound. Control thread."""
        if self.within is None or not self.links:
            return
        free = self._probe is None or self._probe.done()
        if free:
            self._probe = asyncio.ensure_future(host.on_data(lambda: None))
        self._beat += 1
        for link in self.links:
            if isinstance(link, ServerLink):
                link.look(self._beat, free=free)

    def states(self) -> dict[str, LinkState]:
        return {
            link.topic: LinkState(gate=link.gate, count=0, fenced=link.is_silenced, responses=self._responses(link))
            for link in self.links
        }

    def _responses(self, link: OutputLink) -> MeasuredResponses | None:
        """The response times where its mode guarantees a bound."""
        watch = link.watch if self.serving and isinstance(link, ServerLink) else None
        return None if watch is None else watch.responses

    def __repr__(self) -> str:
        words = KIND_WORDS[connector_kind(type_name(self.type, kind=self.kind))]
        return f"<{words.output} {self.name}: {type_name(self.type, kind=self.kind)}>"


class ActionServerPort(ServerPort):
    """A server of a ROS action. Created by ``Component.create_action_server``."""

    kind: ClassVar = "action"

    def __init__(
        self,
        name: str,
        type_: type,
        function: Callable[[Any], Any],
        within: float | None,
        accepts: Callable[[Any], bool | Awaitable[bool]] | None,
        cancels: Callable[[Any], bool | Awaitable[bool]] | None,
    ) -> None:
        super().__init__(name, type_, lambda request, response: None, within, None)
        self._execute = function
        self._accepts = accepts
        self._cancels = cancels
        # Reports what the function raises, once the component runs: the functionality degrades.
        self.failed: Callable[[ServerPort, int, BaseException], object] = lambda server, entered, error: None
        self.entered: Callable[[], int] = lambda: 0

    def make(self, host: Host, name: str) -> ServedService:
        return host.create_action_server(name, self.type, self)

    @property
    def stays(self) -> bool:
        return True

    async def accepts(self, goal: Any) -> bool:
        """Return whether to accept ``goal``, a request for one: never in a mode that does not serve."""
        return self.serving and await _decided(self._accepts, goal)

    async def cancels(self, goal: Any) -> bool:
        """Return whether to cancel a goal that is being executed."""
        return await _decided(self._cancels, goal)

    async def execute(self, goal: Any) -> Any:
        """The result of an accepted goal. Raises what the function raises, which aborts the goal."""
        entered = self.entered()
        try:
            result = self._execute(goal)
            return await result if inspect.isawaitable(result) else result
        except Exception as error:
            self.failed(self, entered, error)
            raise


async def _decided(function: Callable[[Any], Any] | None, goal: Any) -> bool:
    """Return what ``function`` decides, which may be async: where there is none, True."""
    if function is None:
        return True
    found = function(goal)
    return bool(await found if inspect.isawaitable(found) else found)
