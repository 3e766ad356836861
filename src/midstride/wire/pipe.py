"""The in-memory transport: connections within one event loop, for the simulator and for tests."""

from __future__ import annotations

import asyncio
from collections import deque
from functools import partial
from typing import Final
from urllib.parse import unquote

from midstride.errors import NodeError, Unreachable
from midstride.wire.other_hosts import OtherHostAddress
from midstride.wire.transport import Connection, Serve, StopListening

_SCHEME = "memory:"
# The place of locks, unless another one is named.
MEMORY: Final = "memory"


class PipeEnd:
    """One end of a pipe; implements :class:`midstride.wire.transport.Connection`.

    What was sent before an end was closed still arrives, as on a socket.
    """

    peer: int | None = None
    other: PipeEnd

    def __init__(self) -> None:
        self.closed = False
        self._frames: deque[bytes | None] = deque()  # None: the other end has closed
        self._arrived = asyncio.Event()

    async def send(self, frame: bytes) -> None:
        if self.closed or self.other.closed:
            raise Unreachable("the control connection is closed")
        self._transmit(frame)

    async def receive(self) -> bytes | None:
        while not self._frames and not self.closed:
            self._arrived.clear()
            await self._arrived.wait()
        if self.closed or self._frames[0] is None:
            return None
        return self._frames.popleft()

    def arrive(self, frame: bytes | None) -> None:
        """A frame from the other end; None when that end has closed."""
        if not self.closed:
            self._frames.append(frame)
            self._arrived.set()

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self._arrived.set()
            self._transmit(None)

    def _transmit(self, frame: bytes | None) -> None:
        self.other.arrive(frame)


def pipe() -> tuple[PipeEnd, PipeEnd]:
    """The two ends of a new pipe."""
    left, right = PipeEnd(), PipeEnd()
    left.other, right.other = right, left
    return left, right


class PipeLock:
    """Implements :class:`midstride.wire.transport.CutLock`. ``holders`` has, by cut, the lock that holds it."""

    def __init__(self, holders: dict[str, PipeLock], cut: str, place: str = MEMORY) -> None:
        self._holders = holders
        self._cut = cut
        self.place = place
        self._renounced = self._shared = False

    def share(self, place: str) -> None:
        self._shared = self._shared or place == self.place

    def take_freed(self) -> bool:
        return self._shared and self.take()

    def take(self) -> bool:
        if self._renounced:
            return False
        held = self._holders.setdefault(self._cut, self) is self
        self._shared = self._shared or not held
        return held

    @property
    def is_taken(self) -> bool:
        return self._holders.get(self._cut, self) is not self

    def renounce(self) -> bool:
        self._renounced = self._holders.get(self._cut) is not self
        return self._renounced

    def give_back(self) -> None:
        if self._holders.get(self._cut) is self:
            del self._holders[self._cut]


class PipeNetwork:
    """Implements :class:`midstride.wire.transport.Transport` within one event loop."""

    def __init__(self) -> None:
        self.listeners: dict[str, Serve] = {}
        self._serving: set[asyncio.Future[None]] = set()
        self._locks: dict[str, dict[str, PipeLock]] = {}  # by place

    def address(self, instance: str, seen_from: str | None = None) -> str:
        return f"{_SCHEME}{instance}"

    def instance(self, address: str) -> str:
        """The component of an address, here or as a host process names it, or as it is seen from another host."""
        if (other := OtherHostAddress.read(address)) is not None:
            return other.instance
        return (
            unquote(address.rpartition("/")[2].removesuffix(".sock"))
            if address.startswith("unix:")
            else address.removeprefix(_SCHEME)
        )

    def cut_lock(self, cut: str, place: str = MEMORY) -> PipeLock:
        """A lock of ``cut`` among those of one ``place``: those of two places do not exclude each other."""
        return PipeLock(self._locks.setdefault(place, {}), cut, place)

    def present(self) -> dict[str, str]:
        return {instance: self.address(instance) for instance in sorted(self.listeners)}

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        if instance in self.listeners:
            raise NodeError(f"a component {instance} is running already; end it, or give this one another name")
        listening = self.listeners[instance] = partial(serve)  # another object for each listener

        def stop() -> None:
            if self.listeners.get(instance) is listening:
                del self.listeners[instance]

        return stop

    async def connect(self, address: str) -> PipeEnd:
        serve = self.listeners.get(self.instance(address))
        if serve is None:
            raise Unreachable(f"nothing listens at {address}")
        ours, theirs = pipe()
        self.serve(serve, theirs)
        return ours

    def serve(self, serve: Serve, end: Connection) -> None:
        """Run the listener's side of a new connection."""
        task = asyncio.ensure_future(serve(end))
        self._serving.add(task)
        task.add_done_callback(self._serving.discard)
