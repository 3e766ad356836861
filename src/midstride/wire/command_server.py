"""The component's end of its control connections: greeting, requests to a handler, reports to every client."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from midstride.errors import ProtocolError, Unreachable
from midstride.wire.frames import (
    PROTOCOL,
    Frame,
    FromClient,
    Greeting,
    Hello,
    Registration,
    Reply,
    Request,
    StateChanged,
    decode_from_client,
    encode,
)
from midstride.wire.transport import Connection, Listener, Transport

# The reply to a request of a client with this token.
Handler = Callable[[Request, str], Awaitable[Reply]]


class CommandServer:
    """Serves one component at its address. To be used on one event loop, which never runs user code."""

    def __init__(self, greeting: Greeting, handler: Handler) -> None:
        self._greeting = greeting
        self._handler = handler
        self._clients: dict[Connection, asyncio.Task[None]] = {}
        self._answering: set[asyncio.Task[None]] = set()
        self._registration: Registration | None = None
        self._state: StateChanged | None = None
        self._listener: Listener | None = None

    async def open(self, transport: Transport) -> None:
        """Listen. Raises NodeError where the name is taken."""
        self._listener = await transport.listen(self._greeting.instance, self._serve)

    async def close(self, timeout: float) -> None:
        """Take no further requests, answer those under way within ``timeout`` seconds, and close."""
        if self._listener is not None:
            self._listener.close()
        if self._answering:
            await asyncio.wait(self._answering, timeout=timeout)
        for connection, task in list(self._clients.items()):
            task.cancel()
            connection.close()

    def register(self, registration: Registration) -> None:
        """The component is set up: tell every client, and each later one."""
        self._registration = registration
        self._broadcast(registration)

    def report(self, state: StateChanged) -> None:
        """The component's state now, to every client, and to each later one."""
        self._state = state
        self._broadcast(state)

    def _broadcast(self, frame: Frame) -> None:
        line = encode(frame)
        for connection in list(self._clients):
            self._later(self._send(connection, line))

    async def _send(self, connection: Connection, line: bytes) -> None:
        with contextlib.suppress(Unreachable):
            await connection.send(line)

    def _later(self, work: Awaitable[None]) -> None:
        task = asyncio.ensure_future(work)
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)

    async def _serve(self, connection: Connection) -> None:
        task = asyncio.current_task()
        assert task is not None
        try:
            await connection.send(encode(self._greeting))
            hello = await self._receive(connection)
            if not isinstance(hello, Hello) or hello.protocol != PROTOCOL:
                return  # the greeting says which version is spoken here
            self._clients[connection] = task
            for known in (self._registration, self._state):
                if known is not None:
                    await connection.send(encode(known))
            while isinstance(request := await self._receive(connection), Request):
                self._later(self._answer(connection, request, hello.token))
        except (Unreachable, ProtocolError):
            pass  # the client is gone, or is none
        finally:
            self._clients.pop(connection, None)
            connection.close()

    async def _receive(self, connection: Connection) -> FromClient | None:
        line = await connection.receive()
        return None if line is None else decode_from_client(line)

    async def _answer(self, connection: Connection, request: Request, token: str) -> None:
        reply = await self._handler(request, token)
        await self._send(connection, encode(reply))
