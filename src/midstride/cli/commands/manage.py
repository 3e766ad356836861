"""``_manager``: the manager's process, which ``up`` starts. Not in the help."""

from __future__ import annotations

import asyncio
import faulthandler
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

import click

from midstride import backends
from midstride.backends.processes import KEPT_OF_LOG, LONGEST_LOG, listens
from midstride.cli import taking_over
from midstride.cli.input_files import load
from midstride.cli.platforms import make_backend
from midstride.cli.specification_argument import absolute
from midstride.cli.stack_dump import dump_stacks_on_signal
from midstride.codec.specification_form import encode_specification
from midstride.errors import ManagerBusy, SpecificationError
from midstride.model.component import DEFAULT_STOP
from midstride.model.specification import Specification
from midstride.package_files import name_of
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.child_process import end_orphans, shorten
from midstride.runtime.process.descriptors import raise_limit
from midstride.runtime.process.reaper import process_info
from midstride.runtime.records.reports import Event
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.records.status_forms import ChangeLock
from midstride.runtime.workspace import Workspace
from midstride.server.serve import LOOPBACK, Tcp, serve
from midstride.server.service_notice import ServiceNotice
from midstride.wire.environment import ENV_DIAGNOSTICS
from midstride.wire.sockets import SocketFolder

# How often the manager's log is checked (s).
CHECK_LOG: Final = 1.0
# The exit status where another attempt is of no use: EX_CONFIG of sysexits.h.
OF_NO_USE: Final = 78


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
@click.option("--foreground", is_flag=True)
@click.option("--take-over")
@click.option("--replace-manager", is_flag=True)
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
    foreground: bool,
    take_over: str | None,
    replace_manager: bool,
) -> int:
    """Manage the system of FILE until it is down or SIGTERM arrives.

    With `--foreground`, events are printed, systemd is told, and the exit status is 78 where another attempt would be
    of no use: FILE has to be changed first, or another manager of the system runs. What runs of `--take-over` is taken
    over whatever FILE says.
    """
    notice = ServiceNotice.taken_from(os.environ)
    if not foreground:
        notice = None  # what watches this process has started another one
    elif notice is not None and notice.watchdog is not None:
        faulthandler.enable()  # at SIGABRT, by which systemd ends a manager that hangs, it says where that was
    requested = _read(file, take_over)
    tcp = None if http is None else Tcp(http, http_host or LOOPBACK)

    async def run() -> int:
        dump_stacks_on_signal(asyncio.get_running_loop())
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
            platform = make_backend(backend, workspace, middleware_settings=options.middleware_settings)
            specification = _taken_over(saved, requested, file)
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
            if foreground:
                manager.events.listeners.append(_print)
            return await serve(
                manager, workspace, backend=backend, tcp=tcp, metrics_file=metrics_file, notice=notice, alone=foreground
            )
        finally:
            shortening.cancel()

    raise_limit()
    try:
        if take_over is None:
            if isinstance(requested, SpecificationError):
                raise requested
            take_over = requested.name
        workspace = Workspace.of(take_over)
        if replace_manager:
            taking_over.end_earlier(workspace, backend)
        with workspace.lock():
            return backends.run(backend, run())
    except (SpecificationError, ManagerBusy) as error:
        if not foreground:
            raise
        click.echo(f"midstride: {error}", err=True)
        return OF_NO_USE


def _read(file: Path, system: str | None) -> Specification | SpecificationError:
    """The specification in ``file``, or why it cannot be used for ``system``."""
    try:
        requested = load(file)
    except SpecificationError as error:
        return error
    if system is not None and requested.name != system:
        return SpecificationError(f"{file}: its system is {requested.name}, and not {system}; write the unit anew")
    return requested


def _taken_over(saved: SavedState | None, requested: Specification | SpecificationError, file: Path) -> Specification:
    """The specification of what runs already, else the requested one. Raises SpecificationError where neither is there.

    A file that somebody is editing must not keep a system from its next manager.
    """
    if saved is None:
        if isinstance(requested, SpecificationError):
            raise requested
        return requested
    if isinstance(requested, SpecificationError):
        click.echo(f"midstride: {requested}\nThe system is taken over as it runs, without {file}.", err=True)
    elif encode_specification(saved.specification) != encode_specification(requested):
        click.echo(
            f"What runs differs from {file}, and is taken over as it is: `midstride apply` changes it.", err=True
        )
    return saved.specification


def _print(event: Event) -> None:
    """An event on the lines of a log, which has times already."""
    with suppress(OSError):  # who reads has gone: nothing may end for that
        print(event.words, flush=True)


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
    if handle.host:  # only its host knows
        return True
    if handle.pid is None:
        return False
    process = process_info(handle.pid)
    return process is not None and process.alive and process.started == handle.started
