"""XML-RPC over asyncio, in plain Python: what ROS 1's master and nodes speak with each other.

No ROS library is needed for it, so that a manager may run beside ROS 2 on one ``sys.path``; and every
call has a deadline, which rospy's own calls have not (a frozen peer would hold them for good).
"""

from __future__ import annotations

import asyncio
import xmlrpc.client
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within

# How long a master or a node may take to answer what it knows by heart (s).
PATIENCE: Final = 3.0
# A request or an answer longer than this is none of ROS's.
_LONGEST: Final = 64 * 1024 * 1024

Method = Callable[..., Awaitable[Any]]


async def call(uri: str, method: str, *arguments: Any, timeout: float = PATIENCE) -> Any:
    """What the method returns; ROS's ``[code, status, value]`` is left to the caller.

    Raises Unreachable where nobody listens or whoever does speaks otherwise, CallTimeout where no answer comes,
    BackendError where the method is refused.
    """
    try:
        async with within(timeout):
            return await _call(uri, method, arguments)
    except asyncio.TimeoutError:
        raise CallTimeout(f"{uri} did not answer {method} within {timeout:g} s") from None
    except xmlrpc.client.Fault as error:
        raise BackendError(f"{uri} refuses {method}: {error.faultString}") from None
    except (OSError, EOFError, ValueError, ExpatError, xmlrpc.client.Error) as error:
        raise Unreachable(f"{uri} cannot be asked for {method}: {told(error)}") from None


def told(error: BaseException) -> str:
    """An exception in words; some of the network's say nothing by themselves."""
    return str(error) or type(error).__name__


async def _call(uri: str, method: str, arguments: tuple[Any, ...]) -> Any:
    host, port, path = address(uri)
    body = xmlrpc.client.dumps(arguments, method).encode()
    reader, writer = await asyncio.open_connection(host, port)
    try:
        head = f"POST {path} HTTP/1.0\r\nHost: {host}:{port}\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}"
        writer.write(f"{head}\r\n\r\n".encode() + body)
        await writer.drain()
        first, headers = await _head(reader)
        if " 200 " not in f"{first} ":
            raise ValueError(f"it answers {first!r}")
        length = headers.get("content-length")
        answer = await (reader.read() if length is None else reader.readexactly(_sane(length)))
    finally:
        writer.close()
    return xmlrpc.client.loads(answer)[0][0]


def address(uri: str) -> tuple[str, int, str]:
    """Host, port and path of ``http://host:port/``. Raises ValueError."""
    parts = urlsplit(uri)
    if parts.scheme != "http" or parts.hostname is None or parts.port is None:
        raise ValueError(f"{uri!r} is not an address like http://host:11311")
    return parts.hostname, parts.port, parts.path or "/RPC2"


async def _head(reader: asyncio.StreamReader) -> tuple[str, dict[str, str]]:
    """The first line of an HTTP message and its headers."""
    try:
        text = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    except asyncio.LimitOverrunError:
        raise ValueError("it does not speak HTTP") from None
    first, *lines = text.split("\r\n")
    pairs = (line.partition(":") for line in lines if line)
    return first, {name.strip().lower(): value.strip() for name, _, value in pairs}


def _sane(length: str) -> int:
    if not length.isdigit() or int(length) > _LONGEST:
        raise ValueError(f"{length!r} is no sensible length")
    return int(length)


class Server:
    """Answers XML-RPC on a port of its own: the API that the master and other nodes expect of a node."""

    def __init__(self, methods: Mapping[str, Method]) -> None:
        self._methods = methods
        self._server: asyncio.AbstractServer | None = None
        self._busy: set[asyncio.Task[None]] = set()

    async def open(self, host: str) -> int:
        """Listen on ``host``; the port."""
        self._server = await asyncio.start_server(self._answer, host)
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
            for task in self._busy:
                task.cancel()
            await asyncio.gather(*self._busy, return_exceptions=True)
            await self._server.wait_closed()
            self._server = None

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection: requests until the other side has no more (ROS's own clients keep theirs open)."""
        task = asyncio.current_task()
        assert task is not None
        self._busy.add(task)
        try:
            while True:
                _, headers = await _head(reader)
                body = await reader.readexactly(_sane(headers.get("content-length", "")))
                answer = (await self._carry_out(body)).encode()
                head = f"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: {len(answer)}\r\n\r\n"
                writer.write(head.encode() + answer)
                await writer.drain()
        except (OSError, EOFError, ValueError, asyncio.CancelledError):
            pass  # the other side has left or speaks otherwise, or this one is closing
        finally:
            self._busy.discard(task)
            writer.close()

    async def _carry_out(self, body: bytes) -> str:
        try:
            arguments, name = xmlrpc.client.loads(body)
            method = self._methods.get(name or "")
            if method is None:
                return _fault(f"there is no method {name}")
            return xmlrpc.client.dumps((await method(*arguments),), methodresponse=True)
        except (ExpatError, xmlrpc.client.Error, TypeError, ValueError, BackendError) as error:
            return _fault(told(error))


def _fault(words: str) -> str:
    return xmlrpc.client.dumps(xmlrpc.client.Fault(1, words), methodresponse=True)
