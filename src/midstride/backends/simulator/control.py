"""The simulated control plane: pipes with the network's latency, faults on requests, and processes that freeze.

Frames are those of :mod:`midstride.wire`, in both directions, as on a Unix socket.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Literal, Protocol, TypeAlias

from midstride.backends.simulator.clock import SimulatedClock
from midstride.errors import NodeError, Unreachable
from midstride.wire.frames import (
    Reply,
    Request,
    StateChanged,
    command_name,
    decode_from_client,
    decode_from_component,
    encode,
)
from midstride.wire.pipe import PipeEnd, PipeListener, PipeNetwork
from midstride.wire.state import ComponentState
from midstride.wire.transport import Connection, Serve

_SCHEME = "memory:"


RequestFault: TypeAlias = Literal["lost_request", "lost_reply", "refused", "unreachable"]


class RequestFaults(Protocol):
    """The faults planted on requests."""

    def of_call(self, instance: str, op: str) -> RequestFault | None:
        """What is to happen to this request; counts it."""
        ...


class ControlParty(Protocol):
    """The process at one end of a connection."""

    @property
    def instance(self) -> str: ...

    async def thaw(self) -> None:
        """Until it is not frozen. Raises CancelledError where it is dead."""
        ...


class ClientEnd:
    """The end of whoever sends requests: the manager (``party`` None), or the peer of a hand-over."""

    def __init__(self, control: SimulatedControl, instance: str, party: ControlParty | None, end: PipeEnd) -> None:
        self._control = control
        self._instance = instance
        self._party = party
        self._end = end
        self._lost_replies: set[str] = set()

    async def send(self, frame: bytes) -> None:
        if self._party is not None:
            await self._party.thaw()
        request = decode_from_client(frame)
        fault = None
        if isinstance(request, Request):
            name = command_name(request)
            if self._control.before_request is not None:
                await self._control.before_request(self._instance, name)
            fault = self._control.faults.of_call(self._instance, name)
        if fault == "unreachable":
            raise Unreachable("the simulator was told that it cannot be reached")
        if isinstance(request, Request) and fault == "refused":
            words = "the simulator was told to refuse this call"
            self._end.arrive(encode(Reply(id=request.id, revision=-1, refused=words)))
        elif isinstance(request, Request) and fault == "lost_reply":
            self._lost_replies.add(request.id)
        if fault in (None, "lost_reply"):
            await self._end.send(frame)

    async def receive(self) -> bytes | None:
        while (line := await self._end.receive()) is not None:
            if self._party is not None:
                await self._party.thaw()
            if self._control.rewrite_state is not None:
                frame = decode_from_component(line)
                if isinstance(frame, StateChanged):
                    state = self._control.rewrite_state(frame.state)
                    if state is None:
                        continue
                    line = encode(StateChanged(state=state))
            if self._lost_replies:
                frame = decode_from_component(line)
                if isinstance(frame, Reply) and frame.id in self._lost_replies:
                    self._lost_replies.discard(frame.id)
                    continue
            return line
        return None

    def close(self) -> None:
        self._end.close()


class ServerEnd:
    """The component's end: nothing of it happens while its process is frozen."""

    def __init__(self, party: ControlParty, end: PipeEnd) -> None:
        self._party = party
        self._end = end

    async def send(self, frame: bytes) -> None:
        await self._party.thaw()
        await self._end.send(frame)

    async def receive(self) -> bytes | None:
        line = await self._end.receive()
        await self._party.thaw()
        return line

    def close(self) -> None:
        self._end.close()


class DelayedEnd(PipeEnd):
    """One end of a pipe on which a frame takes the network's latency, in order."""

    def __init__(self, clock: SimulatedClock, latency: float) -> None:
        super().__init__()
        self._clock = clock
        self._latency = latency
        self._on_the_way: deque[bytes | None] = deque()

    def _transmit(self, frame: bytes | None) -> None:
        self._on_the_way.append(frame)
        # Timers of one moment come in any order: each of them delivers what is first.
        self._clock.loop.call_later(self._latency, self._deliver)

    def _deliver(self) -> None:
        super()._transmit(self._on_the_way.popleft())


class SimulatedControl:
    """Implements :class:`midstride.wire.transport.Transport` for the manager; :meth:`of` is a process's own."""

    def __init__(self, clock: SimulatedClock, latency: float, faults: RequestFaults) -> None:
        self.faults = faults
        # Awaited before each request, with the component's name and the command's: for tests and rehearsals.
        self.before_request: Callable[[str, str], Awaitable[None]] | None = None
        # What becomes of a state that a component reports; None: it gets lost.
        self.rewrite_state: Callable[[ComponentState], ComponentState | None] | None = None
        self._clock = clock
        self._latency = latency
        self._pipes = PipeNetwork()
        self._parties: dict[str, ControlParty] = {}
        self._ends: dict[ControlParty, list[DelayedEnd]] = {}

    def of(self, party: ControlParty) -> ProcessControl:
        return ProcessControl(self, party)

    def address(self, instance: str) -> str:
        return self._pipes.address(instance)

    def present(self) -> dict[str, str]:
        return self._pipes.present()

    async def listen(self, instance: str, serve: Serve) -> PipeListener:
        raise NodeError("the manager of a simulated system does not listen")

    async def connect(self, address: str) -> Connection:
        return await self.connect_from(None, address)

    async def connect_from(self, party: ControlParty | None, address: str) -> Connection:
        instance = address.removeprefix(_SCHEME)
        listener = self._pipes.listeners.get(instance)
        if listener is None:
            raise Unreachable(f"no component {instance} runs")
        ours, theirs = (DelayedEnd(self._clock, self._latency) for _ in range(2))
        ours.other, theirs.other = theirs, ours
        server = self._parties[instance]
        self._ends.setdefault(server, []).append(theirs)
        if party is not None:
            self._ends.setdefault(party, []).append(ours)
        await asyncio.sleep(self._latency)
        self._pipes.serve(listener.serve, ServerEnd(server, theirs))
        return ClientEnd(self, instance, party, ours)

    async def listen_as(self, party: ControlParty, instance: str, serve: Serve) -> PipeListener:
        listener = await self._pipes.listen(instance, serve)
        self._parties[instance] = party
        return listener

    def remove(self, party: ControlParty) -> None:
        """A process is gone: so are its listener and its connections."""
        for instance in [name for name, other in self._parties.items() if other is party]:
            del self._parties[instance]
            self._pipes.listeners.pop(instance, None)
        for end in self._ends.pop(party, []):
            end.close()


class ProcessControl:
    """Implements :class:`midstride.wire.transport.Transport` for one simulated process."""

    def __init__(self, control: SimulatedControl, party: ControlParty) -> None:
        self._control = control
        self._party = party

    def address(self, instance: str) -> str:
        return self._control.address(instance)

    def present(self) -> dict[str, str]:
        return self._control.present()

    async def listen(self, instance: str, serve: Serve) -> PipeListener:
        return await self._control.listen_as(self._party, instance, serve)

    async def connect(self, address: str) -> Connection:
        return await self._control.connect_from(self._party, address)
