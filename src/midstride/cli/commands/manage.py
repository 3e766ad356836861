"""``_manager``: the manager's own process, started by ``up``. Not for people, so not in the help."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

BACKENDS = ("ros2", "sim")


@click.command("_manager", hidden=True)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--backend", required=True)
@click.option("--http", type=int)
@click.option("--http-host")
def manager_command(file: Path, backend: str, http: int | None, http_host: str | None) -> int:
    """Manage the system of FILE until it is down, or until SIGTERM."""
    from midstride import backends
    from midstride.cli.files import load
    from midstride.runtime.manager import Manager
    from midstride.runtime.workspace import Workspace
    from midstride.server.serve import LOOPBACK, Tcp, serve

    specification = load(file)
    workspace = Workspace.of(specification.name)
    tcp = None if http is None else Tcp(http, http_host or LOOPBACK)

    async def run() -> int:
        manager = Manager(specification, backends.make(backend), workspace, file.resolve().parent)
        return await serve(manager, workspace, backend=backend, tcp=tcp)

    with workspace.lock():
        return asyncio.run(run())
