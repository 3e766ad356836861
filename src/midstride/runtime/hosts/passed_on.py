"""A component's control connection, passed on between the component and the other end of a stream."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from typing import Any

from midstride.errors import ProtocolError
from midstride.wire.frames import LONGEST_FRAME
from midstride.wire.transport import Connection


async def pass_on(connection: Connection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Return once one of the two ends is gone. Neither is closed here."""
    await until_one_ends(_from_component(connection, writer), _to_component(reader, connection))


async def until_one_ends(*directions: Coroutine[Any, Any, None]) -> None:
    """Run the two directions of a connection until one of them ends, however it does."""
    tasks = {asyncio.ensure_future(each) for each in directions}
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _from_component(connection: Connection, writer: asyncio.StreamWriter) -> None:
    while (line := await connection.receive()) is not None:
        writer.write(line + b"\n")
        await writer.drain()


async def _to_component(reader: asyncio.StreamReader, connection: Connection) -> None:
    async for line in _lines(reader):
        await connection.send(line)


async def _lines(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    while (line := await read_line(reader, LONGEST_FRAME)) is not None:
        yield line


async def read_line(reader: asyncio.StreamReader, longest: int) -> bytes | None:
    """The next line; None at the end. Raises ProtocolError for one of more than ``longest`` bytes, OSError."""
    line = await reader.readline()
    if len(line) > longest:
        raise ProtocolError(f"a frame of more than {longest} bytes")
    return line[:-1] if line.endswith(b"\n") else None
