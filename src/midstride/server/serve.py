"""Serves a manager on a Unix socket, and on TCP with a bearer token if requested, until its system is down."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from midstride.errors import ManagerError
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from midstride.server.auth import TokenAuth, new_token
from midstride.server.connections import BACKLOG, Server, connection_limit, listen_tcp
from midstride.server.http_app import create_app
from midstride.server.manager_lifecycle import Lifecycle
from midstride.server.metrics.metrics_source import MetricsFile
from midstride.server.service_notice import ServiceNotice
from midstride.server.view.live import LiveView

log = logging.getLogger(__name__)

LOOPBACK: Final = "127.0.0.1"
# Added to the number of a signal, as a shell does.
_KILLED: Final = 128
# How many connections each kind may have, and which share of the descriptors. The rest is the control plane's.
_UNIX_LIMIT: Final = (256, 1 / 4)
_TCP_LIMIT: Final = (64, 1 / 8)


@dataclass(frozen=True, slots=True)
class Tcp:
    """The address to listen on over TCP: loopback, unless another address of this machine is given."""

    port: int
    host: str = LOOPBACK


async def serve(
    manager: Manager,
    workspace: Workspace,
    *,
    backend: str,
    tcp: Tcp | None = None,
    metrics_file: Path | None = None,
    notice: ServiceNotice | None = None,
    alone: bool = False,
) -> int:
    """Bring the system up and serve it until it is down, or until SIGTERM or SIGINT; components then keep running.

    A change in progress at such a signal is rolled back first. The caller holds the workspace's lock. ``notice``: to
    whom the state of the manager is told. ``alone``: no client waits to read why the system did not come up. Returns
    the exit status: 1 if the system could not be brought up, or a server fails; 128 and the number of the signal that
    has ended the manager while its system was up. Raises ManagerError if a socket cannot be opened; nothing has been
    started then. So it is if ``metrics_file``, which is kept up to date meanwhile, cannot be written.
    """
    lifecycle = Lifecycle(manager, alone=alone)
    metrics = None if metrics_file is None else MetricsFile.require(metrics_file)
    live = LiveView(lifecycle)
    app = create_app(live)
    async with contextlib.AsyncExitStack() as stack:
        servers = [Server(app, stack.enter_context(_unix(workspace.socket)), connection_limit(*_UNIX_LIMIT))]
        if tcp is not None:
            listening = stack.enter_context(_tcp(tcp))
            token = new_token()
            stack.callback(workspace.write_private("token", token).unlink, missing_ok=True)
            protected = TokenAuth(app, token, host=tcp.host, port=tcp.port)
            servers.append(Server(protected, listening, connection_limit(*_TCP_LIMIT)))
        with _on_signals(lifecycle.ended.set) as signals:
            live.start()
            serving = [asyncio.ensure_future(server.serve()) for server in servers]
            lifecycle.bring_up()
            if notice is not None:
                await stack.enter_async_context(notice.kept(lifecycle))
            if metrics is not None:
                await stack.enter_async_context(metrics.kept(lifecycle))
            over = asyncio.ensure_future(lifecycle.until_over())
            await asyncio.wait({over, *serving}, return_when=asyncio.FIRST_COMPLETED)
            lifecycle.ended.set()
            over.cancel()
            interrupting = asyncio.ensure_future(lifecycle.interrupt())
            for server in servers:
                server.should_exit = True
            ends = await asyncio.gather(*serving, return_exceptions=True)
            live.close()
            await asyncio.gather(over, interrupting, return_exceptions=True)
            await manager.close()
    failures = [end for end in ends if isinstance(end, Exception)]
    for failure in failures:
        log.error("a server of the manager has failed, so it exits", exc_info=failure)
    if failures or lifecycle.phase == "failed":
        return 1
    return _KILLED + signals[0] if signals and lifecycle.phase != "down" else 0


@contextlib.contextmanager
def _unix(path: Path) -> Iterator[socket.socket]:
    """A socket that only its user can open. One that a killed manager left is replaced: the caller holds the lock."""
    path.unlink(missing_ok=True)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        listening.bind(str(path))
    except OSError as error:
        listening.close()
        raise ManagerError(f"cannot open the socket {path}: {error.strerror or error}; is the path too long?") from None
    finally:
        os.umask(before)
    try:
        listening.listen(BACKLOG)
        yield listening
    finally:
        listening.close()
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def _tcp(tcp: Tcp) -> Iterator[socket.socket]:
    try:
        found = socket.getaddrinfo(tcp.host, tcp.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = found[0]
        listening = listen_tcp(address, family)
    except OSError as error:
        raise ManagerError(f"cannot listen on {tcp.host}, port {tcp.port}: {error.strerror or error}") from None
    with listening:
        yield listening


@contextlib.contextmanager
def _on_signals(leave: Callable[[], None]) -> Iterator[list[int]]:
    """Call ``leave`` at SIGTERM and SIGINT; the value has the numbers of those that came."""
    loop, came = asyncio.get_running_loop(), list[int]()

    def end(number: int) -> None:
        came.append(number)
        leave()

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, end, number)
    try:
        yield came
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
