"""Services and ROS actions in the simulated middleware: their ends, and the requests under way.

As on ROS 2, every server of a name that the client has discovered receives every request; of two instances of a role
one answers (:mod:`midstride.node.request_admission`). A request and its response take the network's latency, in order.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, Protocol, TypeAlias

from midstride.backends.simulator.message_copy import copied
from midstride.backends.simulator.simulated_future import SimulatedFuture
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.backends.simulator.virtual_clock import SimulatedClock

# What a client asks: a service, or the three services that a ROS action consists of.
RequestKind: TypeAlias = Literal["request", "goal", "result", "cancel"]


@dataclass(eq=False, slots=True)
class SimulatedRequest:
    """One request; ``request`` is what the client has sent.

    ``identity`` is the same at every server; ``future`` is that of its client.
    ``since``: when it was sent (steady s). ``received``: the processes that it has reached; ``executed``: those whose
    code has been called for it.
    ``responses``: how many have been sent.
    """

    identity: str
    kind: RequestKind
    client: ServiceEnd
    request: Any
    future: SimulatedFuture
    since: float
    received: list[SimulatedProcess] = field(default_factory=list)
    executed: list[SimulatedProcess] = field(default_factory=list)
    responses: int = 0
    # What a successor has responded on behalf of the server that has received it.
    passed: Any = None


class ServiceEnd:
    """A server or a client, of a process, with what every end has."""

    def __init__(self, network: ServiceNetwork, owner: SimulatedProcess, name: str, type_: type) -> None:
        self.network = network
        self.owner = owner
        self.name = name if name.startswith("/") else f"/{name}"
        self.type = type_
        self.created = network.middleware.clock.steady()


class ServerEnd(Protocol):
    """A server in the graph."""

    @property
    def end(self) -> ServiceEnd: ...

    def arrive(self, request: SimulatedRequest) -> None:
        """A request reaches its process."""


class ServiceObserver:
    """The events that a simulation may watch; none by default."""

    def on_sent(self, request: SimulatedRequest) -> None:
        """A client has sent it."""

    def on_received(self, request: SimulatedRequest, process: SimulatedProcess) -> None:
        """A server of ``process`` has received the request."""

    def on_executed(self, request: SimulatedRequest, process: SimulatedProcess) -> None:
        """The code of ``process`` is called for it."""

    def on_response(self, request: SimulatedRequest, process: SimulatedProcess, response: Any) -> None:
        """``process`` has sent this response to it."""

    def on_ended(self, goal: str, process: SimulatedProcess, response: Any) -> None:
        """A goal has ended in ``process``, with this response to requests for its result."""


class ServiceMiddleware(Protocol):
    """The simulated middleware, as far as services need it."""

    clock: SimulatedClock
    discovery: float

    @property
    def undiscovering(self) -> Mapping[Any, float]:
        """The processes that find no endpoints any more, and since when (steady s)."""

    def drawn_latency(self) -> float: ...


class ServiceNetwork:
    """The part of ``middleware`` that has services.

    ``outside``: the names that something outside of the system serves; it answers at once, with the defaults.
    """

    def __init__(self, middleware: ServiceMiddleware) -> None:
        self.middleware = middleware
        self.servers: list[ServerEnd] = []
        self.clients: list[ServiceEnd] = []
        self.outside: frozenset[str] = frozenset()
        self.observer = ServiceObserver()
        # Those whose clients still wait for a response, by identity.
        self.waiting: dict[str, SimulatedRequest] = {}
        self._count = 0
        self._serialized: list[Any] = []
        # What is in flight between two ends, in order: when it arrives (steady s), and what happens then.
        self._in_flight: dict[tuple[object, object], deque[tuple[float, Callable[[], object]]]] = {}

    def found(self, client: ServiceEnd) -> list[ServerEnd]:
        """The servers that a client has discovered."""
        middleware = self.middleware
        latest = middleware.clock.steady() - middleware.discovery
        if client.created > latest:
            return []
        blind = middleware.undiscovering.get(client.owner, math.inf)
        return [
            server
            for server in self.servers
            if server.end.name == client.name
            and server.end.type is client.type
            and server.end.created <= latest
            and server.end.created < blind
        ]

    def serves_outside(self, client: ServiceEnd) -> bool:
        return client.name in self.outside

    def send(self, client: ServiceEnd, kind: RequestKind, request: Any) -> SimulatedRequest:
        """Send a request to every server that has been discovered."""
        self._count += 1
        now = self.middleware.clock.steady()
        future = SimulatedFuture(client.owner)
        sent = SimulatedRequest(f"{kind} {self._count}", kind, client, request, future, now)
        self.waiting[sent.identity] = sent
        self.observer.on_sent(sent)
        for server in self.found(client):
            self._deliver((client, server), partial(server.arrive, sent))
        if self.serves_outside(client) and kind == "request":
            self.respond(sent, client.owner, client.type.Response())  # type: ignore[attr-defined]
        return sent

    def respond(self, request: SimulatedRequest, process: SimulatedProcess, response: Any) -> None:
        """Send the response to the client of ``request``."""
        request.responses += 1
        self.observer.on_response(request, process, response)
        answer = copied(response)
        self._deliver((process, request.client), partial(self._arrived, request, answer))

    def send_message(self, client: ServiceEnd, sender: SimulatedProcess, function: Callable[[], object]) -> None:
        """Have ``function`` called in the client's process, as for a message that ``sender`` sends now."""
        self._deliver((sender, client), lambda: client.owner.enqueue(function))

    def serialized(self, message: Any) -> bytes:
        """Return bytes that stand for a copy of ``message``, of any class, in what is sent to another process."""
        self._serialized.append(copied(message))
        return str(len(self._serialized) - 1).encode()

    def deserialized(self, data: bytes) -> Any:
        return copied(self._serialized[int(data)])

    def give_up(self, request: SimulatedRequest) -> None:
        """Note that the client of ``request`` waits for a response no longer."""
        self.waiting.pop(request.identity, None)

    def _arrived(self, request: SimulatedRequest, response: Any) -> None:
        def take() -> None:
            if self.waiting.pop(request.identity, None) is not None and not request.future.done():
                request.future.set_result(response)

        request.client.owner.enqueue(take)

    def _deliver(self, way: tuple[object, object], arrive: Callable[[], object]) -> None:
        """Call ``arrive`` when what is sent now arrives: not before what was sent earlier on that way."""
        middleware = self.middleware
        now = middleware.clock.steady()
        waiting = self._in_flight.setdefault(way, deque())
        at = max(now + middleware.drawn_latency(), waiting[-1][0] if waiting else 0.0)
        waiting.append((at, arrive))
        # Timers of the same moment fire in any order: each delivers what is first.
        middleware.clock.loop.call_later(at - now, self._arrive, way)

    def _arrive(self, way: tuple[object, object]) -> None:
        waiting = self._in_flight[way]
        _, arrive = waiting.popleft()
        if not waiting:
            del self._in_flight[way]
        arrive()

    def remove_process(self, owner: SimulatedProcess) -> None:
        """Remove the ends of a process that has ended."""
        self.servers = [server for server in self.servers if server.end.owner is not owner]
        self.clients = [client for client in self.clients if client.owner is not owner]
        self.waiting = {name: each for name, each in self.waiting.items() if each.client.owner is not owner}
