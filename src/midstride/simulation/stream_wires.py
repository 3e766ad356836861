"""Byte streams between two simulated hosts: asyncio's own reader and writer, over a line that can be cut."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

from midstride.backends.simulator.links import Links
from midstride.wire.frames import LONGEST_FRAME

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Wire(asyncio.Transport):
    """One end. What is written arrives in order; while the line is cut it waits, as on TCP.

    ``line``: the host of this end, and that of the other one. ``latency`` of a line that is not cut (s).
    """

    other: Wire

    def __init__(self, links: Links, line: tuple[str, str], latency: float, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._links, self._line, self._latency, self._loop = links, line, latency, loop
        self.reader = asyncio.StreamReader(limit=LONGEST_FRAME, loop=loop)
        self._protocol = asyncio.StreamReaderProtocol(self.reader, loop=loop)
        self._in_flight: deque[bytes | None] = deque()  # None: the end of what is written
        self.closed = self._lost = False
        self._protocol.connection_made(self)

    @property
    def streams(self) -> Streams:
        return self.reader, asyncio.StreamWriter(self, self._protocol, self.reader, self._loop)

    def write(self, data: Any) -> None:
        if not self.closed:
            self._send(bytes(data))

    def _send(self, data: bytes | None) -> None:
        self._in_flight.append(data)
        # Timers of the same moment fire in any order: each delivers what is first.
        self._links.deliver(*self._line, self._latency, self._deliver)

    def _deliver(self) -> None:
        data = self._in_flight.popleft()
        if data is None:
            self.other.drop()
        elif not self.other._lost:
            self.other._protocol.data_received(data)

    def drop(self) -> None:
        """The connection is over at this end; the other one does not hear of it."""
        self.closed = True
        if not self._lost:
            self._lost = True
            self._protocol.connection_lost(None)

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self._send(None)
            self._loop.call_soon(self.drop)

    def abandon(self) -> None:
        """Whoever is at this end is gone, and hears of nothing; the other one hears that it is."""
        if not self.closed:
            self.closed = self._lost = True
            self._send(None)

    def abort(self) -> None:
        self.close()

    def is_closing(self) -> bool:
        return self.closed

    def can_write_eof(self) -> bool:
        return False

    def get_write_buffer_size(self) -> int:
        return 0

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Nothing is buffered at this end."""

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return default


def wires(links: Links, host: str, other: str, latency: float, loop: asyncio.AbstractEventLoop) -> tuple[Wire, Wire]:
    """The two ends of a new connection: at ``host``, and at the ``other`` one."""
    near, far = Wire(links, (host, other), latency, loop), Wire(links, (other, host), latency, loop)
    near.other, far.other = far, near
    return near, far
