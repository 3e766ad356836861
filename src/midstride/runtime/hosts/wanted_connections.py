"""Connections that components of a host want to components elsewhere: the manager brings each.

The host process cannot reach the manager's host by itself: SSH forwards its socket to there, and nothing the other way.
So the manager is told, connects to the component that is meant, and opens one more connection to the host process, of
which the rest is that control connection.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.hosts.passed_on import until_one_ends
from midstride.runtime.timeouts import within

# How long the manager may take to bring a connection (s): less than the component waits for it.
BRING_SECONDS: Final = 4.0
_LONGEST_PIECE: Final = 256 * 1024


class ManagerConnection(Protocol):
    """The connection of the manager."""

    def push(self, frame: Any) -> None: ...


@dataclass(eq=False)
class _Brought:
    """A connection that the manager has brought, until it is ``used`` no more."""

    hello: frames.BroughtHello
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    used: asyncio.Event = field(default_factory=asyncio.Event)


class WantedConnections:
    """To be used on one event loop."""

    def __init__(self) -> None:
        self._number = 0
        self._waiting: dict[int, asyncio.Future[_Brought]] = {}

    async def pass_on(
        self,
        instance: str,
        manager: ManagerConnection | None,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Serve a component here that wants to reach ``instance``, until one of the two ends is gone."""
        if manager is None:
            await frames.write(writer, frames.Accepted(refused=f"{instance} cannot be reached: the manager cannot"))
            return
        self._number += 1
        number = self._number
        self._waiting[number] = waiting = asyncio.get_running_loop().create_future()
        try:
            manager.push(frames.WantedFrame(number=number, instance=instance))
            async with within(BRING_SECONDS):
                brought = await waiting
        except asyncio.TimeoutError:
            words = f"the manager has not connected to {instance} within {BRING_SECONDS:g} s"
            await frames.write(writer, frames.Accepted(refused=words))
            return
        finally:
            self._waiting.pop(number, None)
        try:
            await frames.write(writer, frames.Accepted(refused=brought.hello.refused, gone=brought.hello.gone))
            if brought.hello.refused is None:
                await _join((reader, writer), (brought.reader, brought.writer))
        finally:
            brought.used.set()

    async def brought(
        self, hello: frames.BroughtHello, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Serve what the manager has brought, until one of the two ends is gone."""
        waiting = self._waiting.get(hello.number)
        if waiting is None or waiting.done():
            return  # it comes too late
        brought = _Brought(hello, reader, writer)
        waiting.set_result(brought)
        await brought.used.wait()


_Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def _join(one: _Streams, other: _Streams) -> None:
    """Copy all bytes both ways; return once one of the two ends is gone."""
    await until_one_ends(_copy(one[0], other[1]), _copy(other[0], one[1]))


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(_LONGEST_PIECE):
        writer.write(data)
        await writer.drain()
