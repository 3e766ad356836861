"""``_manager``: the manager's process, which ``up`` starts. Not in the help."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Final

import click

from midstride import backends
from midstride.backends.processes import KEPT_OF_LOG, LONGEST_LOG, listens
from midstride.cli.input_files import load
from midstride.cli.specification_argument import absolute
from midstride.model.component import DEFAULT_STOP
from midstride.package_files import name_of
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.child_process import end_orphans, shorten
from midstride.runtime.process.descriptors import raise_limit
from midstride.runtime.process.reaper import process_info
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.records.status_forms import ChangeLock
from midstride.runtime.workspace import Workspace
from midstride.server.serve import LOOPBACK, Tcp, serve
from midstride.wire.environment import ENV_DIAGNOSTICS
from midstride.wire.sockets import SocketFolder

# How often the manager's log is checked (s).
CHECK_LOG: Final = 1.0


@click.command("_manager", hidden=True)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--backend", required=True)
@click.option("--http", type=int)
@click.option("--http-host")
@click.option("--use-sim-time", is_flag=True)
@click.option("--no-middleware-settings", is_flag=True)
@click.option("--spares", type=int, default=0)
@click.option("--no-diagnostics", is_flag=True)
@click.option("--finish-interrupted", is_flag=True)
@click.option("--keep-degraded", is_flag=True)
@click.option("--strict", is_flag=True)
@click.option("--metrics-file", type=click.Path(path_type=Path))
def manager_command(
    file: Path,
    backend: str,
    http: int | None,
    http_host: str | None,
    use_sim_time: bool,
    no_middleware_settings: bool,
    spares: int,
    no_diagnostics: bool,
    finish_interrupted: bool,
    keep_degraded: bool,
    strict: bool,
    metrics_file: Path | None,
) -> int:
    """Manage the system of FILE until it is down or SIGTERM arrives."""
    requested = load(file)
    workspace = Workspace.of(requested.name)
    tcp = None if http is None else Tcp(http, http_host or LOOPBACK)

    async def run() -> int:
        shortening = asyncio.ensure_future(_shorten_log(workspace.manager_log))
        try:
            saved, lock = await _still_running(workspace)
            options = SystemOptions(
                use_sim_time,
                not no_middleware_settings,
                spares,
                not no_diagnostics,
                finish_interrupted,
                keep_degraded,
                strict,
            )
            if saved is not None:
                options = saved.options.with_(options)
            if not options.diagnostics:
                os.environ[ENV_DIAGNOSTICS] = "0"  # components have the manager's environment
            platform = backends.make(backend, workspace, middleware_settings=options.middleware_settings)
            specification = requested if saved is None else saved.specification
            path = absolute(file)
            of_package = name_of(str(path), os.environ)
            manager = Manager(
                specification,
                platform,
                workspace,
                path.parent,
                options=options,
                file=path,
                lock=lock,
                package_file=of_package,
            )
            return await serve(manager, workspace, backend=backend, tcp=tcp, metrics_file=metrics_file)
        finally:
            shortening.cancel()

    raise_limit()
    with workspace.lock():
        return backends.run(backend, run())


async def _shorten_log(log: Path) -> None:
    while True:
        await asyncio.sleep(CHECK_LOG)
        shorten(log, LONGEST_LOG, KEPT_OF_LOG)


async def _still_running(workspace: Workspace) -> tuple[SavedState | None, ChangeLock | None]:
    """The state of the system that an earlier manager left running; it is reattached unchanged. And its lock.

    If none of its recorded components runs any more, stop the unrecorded ones and delete the state, but for the lock:
    that has not ended by `down`.
    """
    store = StateStore(workspace.state)
    saved = store.load()
    if saved is None:
        return None, None
    by_hand = SocketFolder(workspace.components)  # the sockets of these are all that is known of them
    running = [
        _runs(entry.handle) if entry.handle else await listens(by_hand, entry.instance.name)
        for entry in saved.instances
        if not entry.done
    ]
    if not any(running):
        await end_orphans(saved.token, (), DEFAULT_STOP)
        store.delete()
        return None, saved.lock
    return saved, saved.lock


def _runs(handle: Handle) -> bool:
    if handle.pid is None:
        return False
    process = process_info(handle.pid)
    return process is not None and process.alive and process.started == handle.started
