"""``host`` and ``_host``: what a manager starts on another host, over SSH. Not in the help."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Final

import click

from midstride import __version__, backends
from midstride.errors import BackendError, ManagerBusy, ManagerError, ProtocolError
from midstride.runtime.hosts.host_order import LONGEST_LINE, HostOrder
from midstride.runtime.hosts.host_service import HostService
from midstride.runtime.hosts.host_start import (
    answer_line,
    directory_of,
    find_or_start,
    remove_passing,
    running,
    socket_of,
)
from midstride.runtime.process.descriptors import raise_limit
from midstride.runtime.workspace import Workspace

# The program that keeps a connection open until the manager's end of it is closed. It needs less memory than Python.
_KEEP: Final = ("sh", "-c", "exec cat >/dev/null")


@click.command("host", hidden=True)
def host_command() -> int:
    """Serve this host to the manager of a system, which calls this over SSH, with its order on standard input.

    Prints one line of JSON, and waits for the end of standard input. The process that serves goes on without it.
    """
    order = HostOrder.read(_order())
    print(answer_line(find_or_start(order, __version__)), flush=True)
    os.execvp(_KEEP[0], _KEEP)


def _order() -> bytes:
    """The first line of standard input, and nothing beyond it."""
    line = bytearray()
    while not line.endswith(b"\n") and len(line) < LONGEST_LINE:
        if not (byte := os.read(0, 1)):
            break
        line += byte
    return bytes(line)


@click.command("_host", hidden=True)
@click.argument("path", type=click.Path(path_type=Path))
def serving_command(path: Path) -> int:
    """Serve this host, with the workspace PATH, until no manager and no component is left."""
    order = HostOrder.read(_order())
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    raise_limit()
    workspace = Workspace(path)

    async def run() -> None:
        backend = backends.make(order.backend, workspace, middleware_settings=order.middleware_settings)
        service = HostService(
            backend,
            order,
            directory=directory_of(order),
            logs=workspace.logs,
            version=__version__,
        )
        try:
            await service.serve(socket_of(workspace))
        finally:
            await backend.close()

    try:
        with workspace.lock():
            asyncio.run(run())
    except ManagerBusy:
        if running(workspace) is None:
            raise
    except (BackendError, ManagerError, ProtocolError) as error:
        print(f"midstride: {error}", file=sys.stderr)
        return 1
    finally:
        remove_passing(workspace)
    return 0
