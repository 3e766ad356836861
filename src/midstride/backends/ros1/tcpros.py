"""TCPROS over asyncio, in plain Python: calling a service, and reading a topic of strings.

The manager needs no more of ROS 1 than this and :mod:`.rpc`. A call has a deadline, holds no thread,
and goes over a connection of its own, so that one that takes long does not delay the next.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping
from typing import Final
from urllib.parse import urlsplit

from midstride.backends.ros1.rpc import told
from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within

# The checksum that stands for any type: the name of the service or topic says enough.
ANY: Final = "*"
_LONGEST: Final = 64 * 1024 * 1024
_SIZE: Final = struct.Struct("<I")


def pack_header(fields: Mapping[str, str]) -> bytes:
    """A connection header: its length, then each ``name=value`` with its length."""
    entries = b"".join(pack_string(f"{name}={value}") for name, value in fields.items())
    return _SIZE.pack(len(entries)) + entries


def unpack_header(data: bytes) -> dict[str, str]:
    """Raises ValueError where ``data`` is no connection header."""
    fields: dict[str, str] = {}
    while data:
        entry, data = _take_string(data)
        name, equals, value = entry.partition("=")
        if not equals:
            raise ValueError(f"{entry!r} is no field of a connection header")
        fields[name] = value
    return fields


def pack_string(text: str) -> bytes:
    """A string as ROS 1 serialises it; a message of one string field is just that."""
    data = text.encode()
    return _SIZE.pack(len(data)) + data


def unpack_string(data: bytes) -> str:
    """Raises ValueError where ``data`` is no message of one string."""
    text, rest = _take_string(data)
    if rest:
        raise ValueError("something follows the string")
    return text


def _take_string(data: bytes) -> tuple[str, bytes]:
    if len(data) < 4:
        raise ValueError("a string's length is cut off")
    end = 4 + _SIZE.unpack_from(data)[0]
    if end > len(data):
        raise ValueError("a string is cut off")
    return data[4:end].decode(), data[end:]


async def read_block(reader: asyncio.StreamReader) -> bytes:
    """A length, and what it is the length of."""
    (length,) = _SIZE.unpack(await reader.readexactly(4))
    if length > _LONGEST:
        raise ValueError(f"{length} bytes are no sensible length")
    return await reader.readexactly(length)


async def handshake(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, fields: Mapping[str, str]
) -> dict[str, str]:
    """Say who calls and for what; the other side's header. Raises ValueError where it refuses."""
    writer.write(pack_header(fields))
    await writer.drain()
    answer = unpack_header(await read_block(reader))
    if "error" in answer:
        raise ValueError(answer["error"])
    return answer


async def call_service(uri: str, service: str, request: str, caller: str, timeout: float) -> str:
    """The reply of a service that takes a string and returns one. ``uri``: ``rosrpc://host:port``.

    Raises CallTimeout, Unreachable where it is not there, BackendError with the words of a service that failed.
    """
    try:
        async with within(timeout):
            return await _call(uri, service, request, caller)
    except asyncio.TimeoutError:
        raise CallTimeout(f"{service} did not answer within {timeout:g} s") from None
    except (OSError, EOFError, ValueError) as error:
        raise Unreachable(f"{service} cannot be called: {told(error)}") from None


async def _call(uri: str, service: str, request: str, caller: str) -> str:
    reader, writer = await _connect(uri)
    try:
        await handshake(reader, writer, {"callerid": caller, "service": service, "md5sum": ANY})
        body = pack_string(request)
        writer.write(_SIZE.pack(len(body)) + body)
        await writer.drain()
        well = await reader.readexactly(1)
        answer = await read_block(reader)
    finally:
        writer.close()
    if well != b"\x01":
        raise BackendError(f"{service}: {answer.decode(errors='replace')}")
    return unpack_string(answer)


async def _connect(uri: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    parts = urlsplit(uri)
    if parts.hostname is None or parts.port is None:
        raise ValueError(f"{uri!r} is no address of a service")
    return await asyncio.open_connection(parts.hostname, parts.port)
