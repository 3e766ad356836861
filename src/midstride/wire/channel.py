"""The client's end of a control connection: requests with their replies, and what the component reports meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import uuid
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

from midstride.errors import CallTimeout, CommandRefused, ProtocolError, Unreachable
from midstride.wire.commands import Command
from midstride.wire.frames import (
    PROTOCOL,
    Greeting,
    Hello,
    Registration,
    Reply,
    Request,
    StateChanged,
    decode_from_component,
    encode,
    encode_value,
)
from midstride.wire.transport import Connection, Transport

R = TypeVar("R")
Report = Registration | StateChanged


class Channel:
    """One connection to one component. ``report`` is called with what it reports, ``ended`` once when it is gone.

    ``greeting`` says which component answered. To be used on one event loop.
    """

    def __init__(
        self,
        connection: Connection,
        greeting: Greeting,
        report: Callable[[Report], None],
        ended: Callable[[], None],
    ) -> None:
        self.greeting = greeting
        self.closed = asyncio.Event()
        self._connection = connection
        self._report = report
        self._ended = ended
        self._waiting: dict[str, asyncio.Future[Reply]] = {}
        self._reading = asyncio.get_running_loop().create_task(self._read())

    @classmethod
    async def open(
        cls,
        transport: Transport,
        address: str,
        token: str,
        *,
        timeout: float,
        report: Callable[[Report], None] = lambda _: None,
        ended: Callable[[], None] = lambda: None,
    ) -> Channel:
        """Connect, and exchange greetings within ``timeout`` seconds.

        Raises Unreachable, CallTimeout (something listens and says nothing), ProtocolError (another version).
        """
        connection = await transport.connect(address)
        try:
            await connection.send(encode(Hello(protocol=PROTOCOL, token=token)))
            receiving = asyncio.ensure_future(connection.receive())
            done, _ = await asyncio.wait({receiving}, timeout=timeout)
            if not done:
                receiving.cancel()
                raise CallTimeout(f"{address} did not greet within {timeout:g} s")
            line = receiving.result()
            if line is None:
                raise Unreachable(f"{address} closed the connection without a word: it may accept other users only")
            greeting = decode_from_component(line)
            if not isinstance(greeting, Greeting):
                raise ProtocolError(f"{address} did not greet first")
            if greeting.protocol != PROTOCOL:
                raise ProtocolError(
                    f"{greeting.instance} speaks version {greeting.protocol} of the control protocol, and this is "
                    f"version {PROTOCOL}: it was started with another version of Midstride; restart it"
                )
        except BaseException:
            connection.close()
            raise
        return cls(connection, greeting, report, ended)

    async def request(self, command: Command[R], *, revision: int | None = None, timeout: float, id: str = "") -> Reply:
        """The reply to one request, whatever it says.

        Raises CallTimeout where none comes within ``timeout`` seconds, Unreachable where the component is gone.
        """
        request = Request(id=id or uuid.uuid4().hex, revision=revision, command=encode_value(command))
        return await self.send(request, timeout)

    async def send(self, request: Request, timeout: float) -> Reply:
        """As :meth:`request`, for a request that is made already."""
        name = self.greeting.instance
        if self.closed.is_set():
            raise Unreachable(f"{name} has closed its control connection")
        waiting: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting[request.id] = waiting
        try:
            await self._connection.send(encode(request))
            await asyncio.wait({waiting}, timeout=timeout)
            if not waiting.done():
                raise CallTimeout(f"{name} did not answer within {timeout:g} s")
            return waiting.result()
        finally:
            if self._waiting.get(request.id) is waiting:
                del self._waiting[request.id]
            waiting.cancel()

    def close(self) -> None:
        """Close it from here; ``ended`` is not called."""
        self._ended = lambda: None
        self._reading.cancel()
        self._end("it was closed")

    async def _read(self) -> None:
        words = "it has closed its control connection"
        try:
            while (line := await self._connection.receive()) is not None:
                self._take(line)
        except ProtocolError as error:
            words = str(error)
        except Exception as error:  # a fault of ours ends the connection, and says so
            words = f"internal error: {error!r}"
        ended = self._ended
        self._end(words)
        ended()

    def _take(self, line: bytes) -> None:
        frame = decode_from_component(line)
        if isinstance(frame, Reply):
            waiting = self._waiting.pop(frame.id, None)  # one that was given up has nobody waiting
            if waiting is not None and not waiting.done():
                waiting.set_result(frame)
        elif isinstance(frame, (Registration, StateChanged)):
            self._report(frame)

    def _end(self, words: str) -> None:
        if self.closed.is_set():
            return
        self.closed.set()
        with contextlib.suppress(Exception):
            self._connection.close()
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(Unreachable(f"{self.greeting.instance} is gone: {words}"))
        self._waiting.clear()


def result_of(reply: Reply, command: Command[R]) -> R:
    """What the command came to. Raises CommandRefused with the component's reason, ProtocolError."""
    if reply.refused is not None:
        raise CommandRefused(reply.refused)
    try:
        result: Any = msgspec.json.decode(reply.result, type=command.reply)
    except msgspec.DecodeError as error:
        raise ProtocolError(f"the reply to `{command.name}` is not one: {error}") from None
    found: R = result
    return found
