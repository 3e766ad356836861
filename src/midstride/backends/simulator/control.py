"""The simulated control plane: pipes with the network's latency, faults on requests, and frozen processes.

The frames are those of :mod:`midstride.wire`, as on a Unix socket.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable

from midstride.backends.simulator.injected_faults import FailingCall, Faults
from midstride.backends.simulator.links import Links
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.errors import CallTimeout, NodeError, Unreachable
from midstride.wire import frames
from midstride.wire.frames import Reply, Request
from midstride.wire.pipe import MEMORY, PipeEnd, PipeLock, PipeNetwork
from midstride.wire.state import ComponentState
from midstride.wire.transport import Connection, Serve, StopListening


class ClientEnd:
    """The end that sends requests, the manager's or that of a peer of a hand-over, with injected faults."""

    peer: int | None = None

    def __init__(self, control: SimulatedControl, instance: str, end: SimulatedEnd) -> None:
        self._control = control
        self._instance = instance
        self._end = end
        self._faulty_replies: dict[str, FailingCall] = {}  # by the id of the request
        # The first reply to each request that was repeated, once there is one.
        self._repeated: dict[str, Reply | None] = {}
        self.close = end.close

    async def send(self, frame: bytes) -> None:
        request = frames.decode_from_client(frame)
        if isinstance(request, Request):
            name = frames.command_name(request)
            if self._control.before_request is not None:
                await self._control.before_request(self._instance, name)
            fault = self._control.faults.take_fault(self._instance, name)
            match None if fault is None else fault.how:
                case "unreachable":
                    raise Unreachable("an injected fault makes it unreachable")
                case "refused":
                    words = "an injected fault refuses this request"
                    self._end.arrive(frames.encode(Reply(id=request.id, revision=-1, refused=words)))
                    return
                case "lost_request":
                    return
                case "delayed_request":
                    assert fault is not None
                    await asyncio.sleep(fault.seconds)
                case "repeated_request":
                    if frames.decode_command(request).kind == "changing":
                        self._repeated[request.id] = None
                    await self._end.send(frame)
                case "lost_reply" | "delayed_reply" | "repeated_reply":
                    assert fault is not None
                    self._faulty_replies[request.id] = fault
        await self._end.send(frame)

    async def receive(self) -> bytes | None:
        while (line := await self._end.receive()) is not None:
            if not self._faulty_replies and not self._repeated and self._control.rewrite_state is None:
                return line
            match frames.decode_from_component(line):
                case frames.StateChanged(state=state) if self._control.rewrite_state is not None:
                    if (rewritten := self._control.rewrite_state(state)) is None:
                        continue
                    line = frames.encode(frames.StateChanged(state=rewritten))
                case Reply(id=id) as reply if id in self._repeated:
                    first = self._repeated.pop(id)
                    if first is None:
                        self._repeated[id] = reply
                    elif first != reply:
                        self._control.on_carried_out_twice(self._instance, first, reply)
                case Reply(id=id) if id in self._faulty_replies:
                    fault = self._faulty_replies.pop(id)
                    if fault.how != "lost_reply":
                        asyncio.get_running_loop().call_later(fault.seconds, self._end.arrive, line)
                    if fault.how != "repeated_reply":
                        continue
            return line
        return None


class SimulatedEnd(PipeEnd):
    """One end of a pipe on which every frame takes the network's latency, and order is kept.

    It neither sends nor receives while its process is frozen; the manager has none.
    """

    def __init__(self, links: Links, latency: float, process: SimulatedProcess | None) -> None:
        super().__init__()
        self._links = links
        self._latency = latency
        self._process = process
        self._in_flight: deque[bytes | None] = deque()

    async def send(self, frame: bytes) -> None:
        if self._process is not None and not self._process.runs:
            await self._process.wait_while_frozen()
        await super().send(frame)

    async def receive(self) -> bytes | None:
        line = await super().receive()
        if self._process is not None and not self._process.runs:
            await self._process.wait_while_frozen()
        return line

    def _transmit(self, frame: bytes | None) -> None:
        self._in_flight.append(frame)
        assert isinstance(self.other, SimulatedEnd)
        # Timers of the same moment fire in any order: each delivers what is first.
        self._links.deliver(*line_between(self._process, self.other._process), self._latency, self._deliver)

    def _deliver(self) -> None:
        super()._transmit(self._in_flight.popleft())


def line_between(sender: SimulatedProcess | None, receiver: SimulatedProcess | None) -> tuple[str, str]:
    """The hosts of both; the manager, or a program that forwards for it, which is None, is on that of the component."""
    if sender is None or receiver is None:
        return MEMORY, MEMORY
    return sender.on, receiver.on


class SimulatedControl:
    """Implements :class:`midstride.wire.transport.Transport` for the manager; :meth:`of` gives that of a process."""

    def __init__(self, links: Links, latency: float, faults: Faults) -> None:
        self.faults = faults
        # Awaited before each request, with the component's name and the command's: for tests and rehearsals.
        self.before_request: Callable[[str, str], Awaitable[None]] | None = None
        # What becomes of a state that a component reports; None: it gets lost.
        self.rewrite_state: Callable[[ComponentState], ComponentState | None] | None = None
        # Called with the instance and both replies where a request that was repeated has another reply than before.
        self.on_carried_out_twice: Callable[[str, Reply, Reply], None] = lambda instance, first, second: None
        self.links = links
        self._latency = latency
        self._pipes = PipeNetwork()
        self._processes: dict[str, SimulatedProcess] = {}
        self._ends: dict[SimulatedProcess, list[SimulatedEnd]] = {}
        self._locks: dict[SimulatedProcess, list[PipeLock]] = {}
        self.address = self._pipes.address
        self.cut_lock = self._pipes.cut_lock
        self.present = self._pipes.present

    def of(self, process: SimulatedProcess) -> ProcessControl:
        return ProcessControl(self, process)

    async def listen(self, instance: str, serve: Serve, process: SimulatedProcess | None = None) -> StopListening:
        if process is None:
            raise NodeError("the manager of a simulated system does not listen")
        stop = await self._pipes.listen(instance, serve)
        self._processes[instance] = process
        return stop

    async def connect(
        self, address: str, process: SimulatedProcess | None = None, host: str | None = None
    ) -> Connection:
        """``host``: that of the client, which is no process of a component; None: that of the component."""
        instance = self._pipes.instance(address)
        serve = self._pipes.listeners.get(instance)
        if serve is None:
            raise Unreachable(f"no component {instance} runs")
        server = self._processes[instance]
        if host not in (None, server.host):
            raise Unreachable(f"no component {instance} runs on {host}")
        line = line_between(process, server)
        if self.links.is_cut(*line) or self.links.is_cut(*reversed(line)):
            raise CallTimeout(f"the line to {instance} is cut")
        ours, theirs = (SimulatedEnd(self.links, self._latency, owner) for owner in (process, server))
        ours.other, theirs.other = theirs, ours
        self._ends[server] = [end for end in self._ends.get(server, []) if not end.closed] + [theirs]
        if process is not None:
            self._ends.setdefault(process, []).append(ours)
        await asyncio.sleep(self._latency)
        self._pipes.serve(serve, theirs)
        return ClientEnd(self, instance, ours)

    def remove(self, process: SimulatedProcess) -> None:
        """Close the listener and the connections of a process that has ended."""
        for instance in [name for name, other in self._processes.items() if other is process]:
            del self._processes[instance]
            self._pipes.listeners.pop(instance, None)
        for end in self._ends.pop(process, []):
            end.close()
        for lock in self._locks.pop(process, []):
            lock.give_back()

    def lock_of(self, process: SimulatedProcess, cut: str) -> PipeLock:
        """A lock that is free again when ``process`` ends."""
        self._locks.setdefault(process, []).append(lock := self._pipes.cut_lock(cut, process.on))
        return lock


class ProcessControl:
    """Implements :class:`midstride.wire.transport.Transport` for one simulated process."""

    def __init__(self, control: SimulatedControl, process: SimulatedProcess) -> None:
        self._control = control
        self._process = process
        self.address = control.address
        self.present = control.present

    def cut_lock(self, cut: str) -> PipeLock:
        return self._control.lock_of(self._process, cut)

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        return await self._control.listen(instance, serve, self._process)

    async def connect(self, address: str) -> Connection:
        return await self._control.connect(address, self._process)


class ControlOfHost:
    """Implements :class:`midstride.wire.transport.Transport` for a program on ``host`` that is no component."""

    def __init__(self, control: SimulatedControl, host: str) -> None:
        self._control, self._host = control, host
        self.address, self.present, self.listen = control.address, control.present, control.listen
        self.cut_lock = control.cut_lock

    async def connect(self, address: str) -> Connection:
        return await self._control.connect(address, host=self._host)
