"""The doors: a Unix socket always, TCP only when asked for; and the manager's life behind them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp

from midstride.errors import ManagerError
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from midstride.server.app import create_app
from midstride.server.auth import BearerAuth, new_token
from midstride.server.lifecycle import Lifecycle

log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
# How long requests under way may take to be answered when the manager ends (s).
LAST_ANSWERS = 2


@dataclass(frozen=True, slots=True)
class Tcp:
    """The TCP door: loopback, unless another address of this machine is named."""

    port: int
    host: str = LOOPBACK


class _Server(uvicorn.Server):
    """uvicorn without its signal handlers: the end of the manager is decided in one place, here."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def serve(manager: Manager, workspace: Workspace, *, backend: str, tcp: Tcp | None = None) -> int:
    """Bring the system up and serve it until it is down, or until SIGTERM or SIGINT: components then go on.

    A change that is under way at such a signal is taken back first. The caller holds the workspace's lock. Returns
    the exit status: 1 where the system could not be brought up, or a door fails. Raises ManagerError where one cannot
    be opened; nothing has been started then.
    """
    lifecycle = Lifecycle(manager)
    app = create_app(lifecycle, backend=backend)
    token_file = workspace.path / "token"
    with contextlib.ExitStack() as doors:
        servers = [(_server(app), doors.enter_context(_unix(workspace.socket)))]
        if tcp is not None:
            listening = doors.enter_context(_tcp(tcp))
            doors.callback(token_file.unlink, missing_ok=True)
            servers.append((_server(BearerAuth(app, new_token(token_file))), listening))
        with _signals(lifecycle):
            serving = [asyncio.ensure_future(server.serve([door])) for server, door in servers]
            up = asyncio.ensure_future(lifecycle.bring_up())
            over = asyncio.ensure_future(lifecycle.until_over())
            await asyncio.wait({over, *serving}, return_when=asyncio.FIRST_COMPLETED)
            lifecycle.ended.set()
            up.cancel()
            over.cancel()
            breaking_off = asyncio.ensure_future(lifecycle.break_off())
            for server, _ in servers:
                server.should_exit = True
            ends = await asyncio.gather(*serving, return_exceptions=True)
            await asyncio.gather(up, over, breaking_off, return_exceptions=True)
            await manager.close()
    failures = [end for end in ends if isinstance(end, Exception)]
    for failure in failures:
        log.error("a door of the manager has failed, so it ends", exc_info=failure)
    return 1 if failures or lifecycle.phase == "failed" else 0


def _server(app: ASGIApp) -> _Server:
    config = uvicorn.Config(
        app, log_config=None, access_log=False, lifespan="off", timeout_graceful_shutdown=LAST_ANSWERS, ws="none"
    )
    return _Server(config)


@contextlib.contextmanager
def _unix(path: Path) -> Iterator[socket.socket]:
    """A socket file that only its user can open; one left by a killed manager makes way (the lock is held)."""
    path.unlink(missing_ok=True)
    door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        door.bind(str(path))
    except OSError as error:
        door.close()
        raise ManagerError(f"cannot open the socket {path}: {error.strerror or error}; is the path too long?") from None
    finally:
        os.umask(before)
    try:
        door.listen(128)
        yield door
    finally:
        door.close()
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def _tcp(tcp: Tcp) -> Iterator[socket.socket]:
    try:
        found = socket.getaddrinfo(tcp.host, tcp.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = found[0]
        door = socket.create_server(address, family=family)
    except OSError as error:
        raise ManagerError(f"cannot listen on {tcp.host}, port {tcp.port}: {error.strerror or error}") from None
    with door:
        yield door


@contextlib.contextmanager
def _signals(lifecycle: Lifecycle) -> Iterator[None]:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, lifecycle.leave)
    try:
        yield
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
