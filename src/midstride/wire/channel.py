"""The client's end of a control connection: requests with their replies, and what the component reports meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import uuid
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import msgspec

from midstride.errors import CallTimeout, CommandRefused, ProtocolError, Unreachable, internal_error
from midstride.wire import frames
from midstride.wire.commands import Command
from midstride.wire.frames import Reply
from midstride.wire.transport import FORWARDED, Connection, Transport

R = TypeVar("R")
T = TypeVar("T")
ComponentReport = frames.Registration | frames.StateChanged


@dataclass(eq=False)
class Channel:
    """One connection to one component. ``report`` is called with each of its reports, ``ended`` once when it is gone.

    ``greeting`` says which component answered; ``direct`` whether its process is the other end, so that it has exited
    where nothing listens any more. To be used on one event loop.
    """

    connection: Connection
    greeting: frames.Greeting
    report: Callable[[ComponentReport], None]
    ended: Callable[[], None]

    def __post_init__(self) -> None:
        self.direct = self.connection.peer in (None, self.greeting.pid)
        self.closed = asyncio.Event()
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
        report: Callable[[ComponentReport], None] = lambda _: None,
        ended: Callable[[], None] = lambda: None,
    ) -> Channel:
        """Connect, and exchange greetings within ``timeout`` seconds.

        Raises Unreachable, CallTimeout (something listens but does not greet, or as ``transport.connect``),
        ProtocolError (a version that is not spoken here).
        """
        protocol = frames.PROTOCOL
        while True:
            connection = await transport.connect(address)
            hello = frames.Hello(protocol=protocol, token=token)
            try:
                greeting = await in_time(
                    timeout, _greet(connection, address, hello), f"{address} did not greet within {timeout:.3g} s"
                )
                if greeting.protocol == protocol:
                    return cls(connection, greeting, report, ended)
                if protocol != frames.PROTOCOL:
                    raise ProtocolError(f"{greeting.instance} greets in another version of the protocol each time")
            except BaseException:
                connection.close()
                raise
            connection.close()
            protocol = greeting.protocol

    async def request(self, command: Command[R], *, revision: int | None = None, timeout: float, id: str = "") -> Reply:
        """The reply to one request, whatever it says.

        Raises CallTimeout where none comes within ``timeout`` seconds, Unreachable where the component is gone.
        """
        return await self.send(_request(command, revision, id), timeout)

    def begin(self, command: Command[R], *, revision: int | None = None, id: str = "") -> asyncio.Task[Reply]:
        """Send ``command`` without a limit of time: a task, to be cancelled when the reply is no longer waited for."""
        self._require_open()
        return asyncio.get_running_loop().create_task(self._exchange(_request(command, revision, id)))

    async def send(self, request: frames.Request, timeout: float) -> Reply:
        """Send a complete request, whose id must not be that of one under way; see :meth:`request`."""
        self._require_open()
        words = f"{self.greeting.instance} did not answer within {timeout:.3g} s"
        return await in_time(timeout, self._exchange(request), words)

    def _require_open(self) -> None:
        if self.closed.is_set():
            raise Unreachable(f"{self.greeting.instance} has closed its control connection")

    async def _exchange(self, request: frames.Request) -> Reply:
        waiting: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting[request.id] = waiting
        try:
            await self.connection.send(frames.encode(request))
            return await waiting
        finally:
            if self._waiting.get(request.id) is waiting:  # not that of a repetition
                del self._waiting[request.id]
            if waiting.done() and not waiting.cancelled():
                waiting.exception()  # retrieved: the connection may have ended while the request was being sent

    def close(self) -> None:
        """Close the connection; neither ``report`` nor ``ended`` is called any more."""
        self.report = lambda _: None
        self.ended = lambda: None
        self._reading.cancel()
        self._end("the connection was closed at this end")

    async def _read(self) -> None:
        words = "it has closed its control connection"
        try:
            while (line := await self.connection.receive()) is not None:
                self._take(line)
        except ProtocolError as error:
            words = str(error)
        except Exception as error:  # of the caller's `report`
            words = internal_error(error)
            asyncio.get_running_loop().call_exception_handler(
                {"message": f"handling a report of {self.greeting.instance} failed", "exception": error}
            )
        ended = self.ended
        self._end(words)
        ended()

    def _take(self, line: bytes) -> None:
        frame = frames.decode_from_component(line)
        if isinstance(frame, Reply):
            waiting = self._waiting.pop(frame.id, None)  # None: the request has timed out, and its reply is late
            if waiting is not None and not waiting.done():
                waiting.set_result(frame)
        elif isinstance(frame, (frames.Registration, frames.StateChanged)):
            self.report(frame)

    def _end(self, words: str) -> None:
        if self.closed.is_set():
            return
        self.closed.set()
        with contextlib.suppress(Exception):
            self.connection.close()
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(Unreachable(f"{self.greeting.instance} is gone: {words}"))


async def _greet(connection: Connection, address: str, hello: frames.Hello) -> frames.Greeting:
    with contextlib.suppress(Unreachable):  # closed at once, which is explained below
        await connection.send(frames.encode(hello))
    line = await connection.receive()
    if line is None:
        kind = CallTimeout if connection.peer == FORWARDED else Unreachable
        raise kind(f"{address} closed the connection without a greeting: it may accept other users only")
    return frames.decode_greeting(line)


def _request(command: Command[Any], revision: int | None, id: str) -> frames.Request:
    return frames.Request(id=id or uuid.uuid4().hex, revision=revision, command=frames.encode_value(command))


async def in_time(timeout: float, work: Coroutine[Any, Any, T], words: str) -> T:
    """Await ``work``, and return its result. Raises CallTimeout with ``words`` after ``timeout`` seconds, and
    ends it.
    """
    task = asyncio.get_running_loop().create_task(work)
    try:
        await asyncio.wait({task}, timeout=timeout)
        if not task.done():
            raise CallTimeout(words)
        return task.result()
    finally:
        task.cancel()


def result_of(reply: Reply, command: Command[R]) -> R:
    """The result of the command. Raises CommandRefused with the component's reason, ProtocolError."""
    if reply.refused is not None:
        raise CommandRefused(reply.refused)
    try:
        return cast(R, msgspec.json.decode(reply.result, type=command.reply))
    except frames.INVALID as error:
        raise ProtocolError(f"the reply to `{command.name}` is malformed: {error}") from None
