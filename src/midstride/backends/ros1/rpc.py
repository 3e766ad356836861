"""XML-RPC over asyncio, in plain Python: the protocol of ROS 1's master and nodes.

It needs no ROS library, so a manager can run beside ROS 2 on one ``sys.path``. Every call has a deadline, which rospy's
own calls lack: a frozen peer would block them for ever.
"""

from __future__ import annotations

import asyncio
import xmlrpc.client
from contextlib import suppress
from typing import Any, Final
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within

# How long a master or a node may take to answer from memory (s).
PATIENCE: Final = 3.0
# No answer of ROS is longer than this (bytes).
_LONGEST: Final = 64 * 1024 * 1024


async def call(uri: str, method: str, *arguments: Any, timeout: float = PATIENCE) -> Any:
    """Call the method, and return its result; ROS's ``[code, status, value]`` is left to the caller.

    Raises Unreachable where nothing listens or where the listener does not speak XML-RPC, CallTimeout where no answer
    comes, BackendError where the method is refused.
    """
    try:
        async with within(timeout):
            return await _call(uri, method, arguments)
    except asyncio.TimeoutError:
        raise CallTimeout(f"{uri} did not answer {method} within {timeout:g} s") from None
    except xmlrpc.client.Fault as error:
        raise BackendError(f"{uri} refuses {method}: {error.faultString}") from None
    except (OSError, EOFError, ValueError, ExpatError, xmlrpc.client.Error) as error:
        raise Unreachable(f"{uri} cannot be called ({method}): {str(error) or type(error).__name__}") from None


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
            raise ValueError(f"the answer begins with {first!r}")
        length = headers.get("content-length")
        if length is not None and not (length.isdigit() and int(length) <= _LONGEST):
            raise ValueError(f"{length!r} is not a plausible length")
        answer = await (reader.read() if length is None else reader.readexactly(int(length)))
    finally:
        writer.close()
    return xmlrpc.client.loads(answer)[0][0]


def address(uri: str) -> tuple[str, int, str]:
    """Host, port and path of ``http://host:port/``. Raises ValueError."""
    parts = urlsplit(uri)
    with suppress(ValueError):  # the port is no number
        if parts.scheme == "http" and parts.hostname is not None and parts.port is not None:
            return parts.hostname, parts.port, parts.path or "/RPC2"
    raise ValueError(f"{uri!r} is not an address like http://host:11311")


async def _head(reader: asyncio.StreamReader) -> tuple[str, dict[str, str]]:
    """The first line of an HTTP message and its headers."""
    try:
        text = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    except asyncio.LimitOverrunError:
        raise ValueError("the answer is not HTTP") from None
    first, *lines = text.split("\r\n")
    pairs = (line.partition(":") for line in lines if line)
    return first, {name.strip().lower(): value.strip() for name, _, value in pairs}
