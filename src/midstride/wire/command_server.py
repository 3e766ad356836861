"""The component's end of its control connections: greeting, requests to a handler, reports to every client."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any, Final

from msgspec import structs

from midstride.errors import CallTimeout, ProtocolError, Unreachable
from midstride.wire import frames
from midstride.wire.channel import in_time
from midstride.wire.frames import Reply, Request
from midstride.wire.state import WireValue
from midstride.wire.transport import Connection, StopListening, Transport

# The reply to a request of a client with this token.
RequestHandler = Callable[[Request, str], Awaitable[Reply]]
# The result of one kind of command.
CommandHandler = Callable[[Any], Awaitable[WireValue]]

# How long a client may take to greet (s).
HELLO_TIMEOUT: Final = 10.0
# How many requests of one client may be under way, or answered and not yet sent. Its next ones are not read until then.
UNDER_WAY: Final = 64


class _Client:
    """One connection, and what is still to be sent on it.

    A client that does not read (its process is stopped) must cost a bounded amount of memory: a state that is not yet
    sent is replaced by the next one, and replies are bounded by ``UNDER_WAY``.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.room = asyncio.Semaphore(UNDER_WAY)
        self._frames: deque[frames.Frame] = deque()
        self._state: frames.StateChanged | None = None
        self._arrived = asyncio.Event()
        self.flushed = asyncio.Event()

    def put(self, frame: frames.Frame) -> None:
        """Send ``frame`` after earlier ones; a state replaces an earlier one that is not yet sent."""
        if isinstance(frame, frames.StateChanged):
            waiting, self._state = self._state, frame
            if waiting is not None:
                return
        self._frames.append(frame)
        self.flushed.clear()
        self._arrived.set()

    async def write(self) -> None:
        """Send what is put, until cancelled or until the client is gone."""
        try:
            while True:
                while not self._frames:
                    self.flushed.set()
                    self._arrived.clear()
                    await self._arrived.wait()
                frame = self._frames.popleft()
                if isinstance(frame, frames.StateChanged) and self._state is not None:
                    frame, self._state = self._state, None
                await self.connection.send(frames.encode(frame))
                if isinstance(frame, Reply):
                    self.room.release()
        except Unreachable:
            pass
        finally:
            self.flushed.set()


class CommandServer:
    """Serves one component at its address. To be used on one event loop, which never runs user code."""

    def __init__(self, greeting: frames.Greeting, handler: RequestHandler) -> None:
        self._greeting = greeting
        self._handler = handler
        self._clients: list[_Client] = []
        self._connections: dict[Connection, asyncio.Task[None]] = {}
        self._answering: set[asyncio.Task[None]] = set()
        self._registration: frames.Registration | None = None
        self._state: frames.StateChanged | None = None
        self._stop_listening: StopListening = lambda: None

    async def open(self, transport: Transport) -> None:
        """Listen. Raises NodeError where the name is taken."""
        self._stop_listening = await transport.listen(self._greeting.instance, self._serve)
        lock = transport.cut_lock("")
        self._greeting = structs.replace(self._greeting, place=lock.place)
        lock.give_back()

    async def close(self, timeout: float) -> None:
        """Accept no further clients, answer the requests under way within ``timeout`` seconds, and disconnect."""
        self._stop_listening()
        finishing = asyncio.ensure_future(self._finish())
        await asyncio.wait({finishing}, timeout=timeout)
        finishing.cancel()
        for connection, task in list(self._connections.items()):
            task.cancel()
            connection.close()

    async def _finish(self) -> None:
        await asyncio.gather(*self._answering, return_exceptions=True)
        await asyncio.gather(*(client.flushed.wait() for client in self._clients))

    def register(self, registration: frames.Registration) -> None:
        """The component is set up: report it to every client, and to each later one."""
        self._registration = registration
        self._broadcast(registration)

    def report(self, state: frames.StateChanged) -> None:
        """The component's state now, to every client, and to each later one."""
        self._state = state
        self._broadcast(state)

    def _broadcast(self, frame: frames.Frame) -> None:
        for client in self._clients:
            client.put(frame)

    async def _serve(self, connection: Connection) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections[connection] = task
        try:
            hello = await self._hello(connection)
            greeting = self._greeting
            if isinstance(hello, frames.Hello) and hello.protocol in frames.SPOKEN:
                # An earlier version refuses any but its own.
                greeting = structs.replace(greeting, protocol=min(greeting.protocol, hello.protocol))
                if greeting.protocol < frames.WITH_PLACE:
                    greeting = structs.replace(greeting, place="")
            await connection.send(frames.encode(greeting))
            if isinstance(hello, frames.Hello) and hello.protocol == greeting.protocol:
                await self._serve_client(_Client(connection), hello.token)
        except (CallTimeout, Unreachable, ProtocolError):
            pass  # the client is gone, or what connected is not a client
        finally:
            del self._connections[connection]
            connection.close()

    async def _hello(self, connection: Connection) -> frames.FromClient | None:
        """The first frame of the client; None where there is none, or none that can be read."""
        try:
            return await in_time(HELLO_TIMEOUT, self._receive(connection), "the client did not greet")
        except (CallTimeout, ProtocolError):
            return None

    async def _serve_client(self, client: _Client, token: str) -> None:
        for known in (self._registration, self._state):
            if known is not None:
                client.put(known)
        self._clients.append(client)
        tasks = {asyncio.ensure_future(work) for work in (self._read(client, token), client.write())}
        try:
            # Only the writer notices the end of a client whose requests are not read because of UNDER_WAY.
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._clients.remove(client)
            for task in tasks:
                task.cancel()

    async def _read(self, client: _Client, token: str) -> None:
        with contextlib.suppress(Unreachable, ProtocolError):  # it is gone, or has sent something else
            await client.room.acquire()
            while isinstance(request := await self._receive(client.connection), Request):
                answering = asyncio.ensure_future(self._answer(client, request, token))
                self._answering.add(answering)
                answering.add_done_callback(self._answering.discard)
                await client.room.acquire()

    async def _receive(self, connection: Connection) -> frames.FromClient | None:
        line = await connection.receive()
        return None if line is None else frames.decode_from_client(line)

    async def _answer(self, client: _Client, request: Request, token: str) -> None:
        client.put(await self._handler(request, token))
