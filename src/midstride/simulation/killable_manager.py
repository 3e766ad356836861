"""A manager that can be killed: what it reaches outside the process is cut off at that moment.

Nothing of a killed process runs any more. Here its coroutines are still there, so each of them is stopped where it next
reaches outside: the control connections, the processes, the clock, or the disk.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from typing import Any

from midstride.errors import Unreachable
from midstride.model.component import StopTimes
from midstride.runtime.backend_protocol import Exited, Handle, Launch, RemainingProcess
from midstride.wire import frames
from midstride.wire.transport import Connection, Serve, StopListening


class ManagerKilled(BaseException):
    """The manager has been killed: raised where it writes to the disk, which cannot wait."""


class Life:
    """The life of one manager. ``backend`` is what it is made with (:mod:`midstride.runtime.backend_protocol`).

    ``simulator``: the back end that this one stands before; it is told by `killed` and `isolated`, where it has them.
    """

    def __init__(self, simulator: Any) -> None:
        self.alive = True
        self._inner = simulator
        self.backend: Any = _Backend(self, simulator)
        self._connections: list[Connection] = []
        self._under_way: dict[asyncio.Future[Any], None] = {}  # in order: that of a set differs from run to run
        self._over: asyncio.Future[None] | None = None  # once something waits for the end of the simulation
        self._buried = False
        # While it is cut off: done once it reaches the outside again.
        self.cut_off: asyncio.Future[None] | None = None
        # What is called with each command that would change something, and with each process that it starts or ends.
        self.on_change: Callable[[str], None] = lambda words: None
        # What is called with each connection to another host that it makes once it is no longer cut off.
        self.on_connected: Callable[[str], None] = lambda words: None

    def kill(self) -> None:
        if self.alive:
            self.alive = False
            self._tell("killed")
            for connection in self._connections:
                connection.close()
            for call in self._under_way:
                call.cancel()

    def isolate(self) -> None:
        """Cut it off: it lives, and neither reaches anything outside nor hears of it, until :meth:`reconnect`."""
        self.cut_off = asyncio.get_running_loop().create_future()
        self._tell("isolated")

    def _tell(self, what: str) -> None:
        """The back end may have connections that are not made through this one."""
        if (tell := getattr(self._inner, what, None)) is not None:
            tell()

    @property
    def is_back(self) -> bool:
        """Return whether it has been cut off, and reaches the outside again: another manager may have the lease."""
        return self.cut_off is not None and self.cut_off.done()

    def reconnect(self) -> None:
        if self.cut_off is not None and not self.cut_off.done():
            self.cut_off.set_result(None)

    def bury(self) -> None:
        """The simulation ends: what still waits may end, and what comes to wait from now on."""
        self.alive = False
        self._buried = True
        self.reconnect()
        if self._over is not None and not self._over.done():
            self._over.set_result(None)

    async def breath(self) -> None:
        """Returns while it lives and is not cut off, and never again once it has been killed.

        Raises Unreachable once it is buried. What ends then may still come here, in `finally`: it must not wait again,
        since nothing would end that.
        """
        while self.cut_off is not None and not self.cut_off.done():
            await asyncio.shield(self.cut_off)
        if not self.alive:
            if not self._buried:
                if self._over is None:
                    self._over = asyncio.get_running_loop().create_future()
                await asyncio.shield(self._over)
            raise Unreachable("the manager has been killed")

    async def call(self, function: Callable[..., Awaitable[Any]], *args: Any) -> Any:
        """Call ``function``, and return its result if the manager still lives then."""
        await self.breath()
        task = asyncio.ensure_future(function(*args))
        self._under_way[task] = None
        try:
            return await task
        finally:
            del self._under_way[task]
            await self.breath()


class _Guarded:
    """``inner``, whose coroutines end with the manager's life."""

    def __init__(self, life: Life, inner: Any) -> None:
        self._life = life
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._inner, name)
        if not inspect.iscoroutinefunction(found):
            if inspect.ismethod(found):
                self.__dict__[name] = found
            return found

        async def guarded(*args: Any) -> Any:
            return await self._life.call(found, *args)

        self.__dict__[name] = guarded
        return guarded


class _Backend(_Guarded):
    def __init__(self, life: Life, simulator: Any) -> None:
        super().__init__(life, simulator)
        self.name = simulator.name
        self.clock = _Clock(life, simulator.clock)
        self.transport = _Transport(life, simulator.transport)

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        def exited(event: Exited) -> None:
            if self._life.alive:
                on_exit(event)

        await self._life.call(self._inner.open, exited)

    async def start(self, launch: Launch) -> Handle:
        await self._life.breath()
        self._life.on_change(f"starts {launch.instance}")
        handle: Handle = await self._life.call(self._inner.start, launch)
        return handle

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        await self._life.breath()
        self._life.on_change(f"ends {instance}")
        end = self._inner.end if self._life.cut_off is None else self._inner.end_unexpectedly
        killed: list[RemainingProcess] = await self._life.call(end, instance, stop)
        return killed


class _Clock(_Guarded):
    async def sleep(self, seconds: float) -> None:
        await self._life.breath()
        await asyncio.sleep(seconds)
        await self._life.breath()


class _Transport(_Guarded):
    async def listen(self, instance: str, serve: Serve) -> StopListening:
        listening: StopListening = await self._life.call(self._inner.listen, instance, serve)
        return listening

    async def connect(self, address: str) -> Connection:
        connection = await self._life.call(self._inner.connect, address)
        self._life._connections.append(connection)
        return _Connection(self._life, connection)


class _Connection:
    peer: int | None = None

    def __init__(self, life: Life, inner: Connection) -> None:
        self._life = life
        self._inner = inner
        self.close = inner.close

    async def send(self, frame: bytes) -> None:
        await self._life.breath()
        if self._life.cut_off is not None:  # it is back: another manager may have the lease
            request = frames.decode_from_client(frame)
            if isinstance(request, frames.Request) and frames.decode_command(request).kind == "changing":
                self._life.on_change(f"sends `{frames.command_name(request)}`")
        await self._inner.send(frame)
        await self._life.breath()

    async def receive(self) -> bytes | None:
        frame = await self._inner.receive()
        await self._life.breath()
        return frame
