"""HTTP connections: how many there may be, and how long a request may take to arrive.

uvicorn limits neither (its `limit_concurrency` counts requests, its `timeout_keep_alive` ends with the next byte), and
asyncio's own accept loop, at the limit of descriptors, logs and schedules a retry for every place in its backlog.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import resource
import socket
from collections.abc import Callable, Iterator
from typing import Any, Final

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

log = logging.getLogger(__name__)

# How long a request, with its body, may take to arrive after the connection opened or the last response (s).
REQUEST_TIMEOUT: Final = 20.0
# How long requests in progress may take when the manager exits (s).
LAST_ANSWERS: Final = 2
# How many connections may wait to be accepted.
BACKLOG: Final = 128
# How long to wait after a connection could not be accepted (s).
_RETRY: Final = 0.1


def connection_limit(limit: int, share: float) -> int:
    """``limit``, or fewer where that would take more than ``share`` of the descriptors that this process may open."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if descriptors == resource.RLIM_INFINITY:
        return limit
    return max(1, min(limit, int(descriptors * share)))


def listen_tcp(address: tuple[Any, ...], family: int = socket.AF_INET) -> socket.socket:
    """A socket that listens on ``address``. Raises OSError."""
    listening = socket.create_server(address, family=family, backlog=BACKLOG)
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else a kept connection answers 40 ms late
    return listening


class _Connection(H11Protocol):
    """A connection that is closed if a request does not arrive in time. Calls ``on_close`` once it is closed."""

    def __init__(self, *arguments: Any, on_close: Callable[[], None]) -> None:
        super().__init__(*arguments)
        self._on_close = on_close
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        super().connection_made(transport)
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._stop_timer()
        self._on_close()

    def on_response_complete(self) -> None:
        self._await_request()
        super().on_response_complete()

    def handle_events(self) -> None:
        super().handle_events()
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):  # the request has arrived
            self._stop_timer()

    def _await_request(self) -> None:
        self._stop_timer()
        self._timer = self.loop.call_later(REQUEST_TIMEOUT, self.transport.abort)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()


class Server(uvicorn.Server):
    """Serves ``app`` on one listening socket, with at most ``limit`` connections; the kernel keeps others waiting.

    It has no signal handlers: the manager decides when it exits, and then sets ``should_exit``.
    """

    def __init__(self, app: ASGIApp, listening: socket.socket, limit: int) -> None:
        config = uvicorn.Config(
            app,
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            log_level="error",  # not what clients do wrong
            access_log=False,
            timeout_graceful_shutdown=LAST_ANSWERS,
        )
        super().__init__(config)
        listening.setblocking(False)
        self._listening = listening
        self._free = asyncio.Semaphore(limit)
        self._accepting: asyncio.Task[None] | None = None

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup([])  # uvicorn listens on none: its connections come from `_accept`
        self._accepting = asyncio.ensure_future(self._accept())

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        if self._accepting is not None:
            self._accepting.cancel()
            await asyncio.wait({self._accepting})
        await super().shutdown([self._listening])  # closes it

    async def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        failed = False
        while True:
            await self._free.acquire()
            try:
                connection, _ = await loop.sock_accept(self._listening)
            except OSError as error:
                if not failed:
                    log.warning("cannot accept a connection, trying again: %s", error.strerror or error)
                failed = True
                self._free.release()
                await asyncio.sleep(_RETRY)
                continue
            failed = False
            await loop.connect_accepted_socket(self._protocol, connection)

    def _protocol(self) -> _Connection:
        return _Connection(self.config, self.server_state, {}, on_close=self._free.release)
