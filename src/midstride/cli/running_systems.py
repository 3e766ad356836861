"""Finds the running system that a command is about."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from midstride.cli import shell_completion
from midstride.cli.client import Client
from midstride.errors import ManagerError, MidstrideError, NoManager, PlanRefused
from midstride.model.diagnostics import suggestion
from midstride.runtime.workspace import Workspace
from midstride.wire.folders import workspace_root

if TYPE_CHECKING:
    from midstride.runtime.records.status_forms import Status

# How long to wait for a manager that does not answer: it may be starting or exiting (s).
ANSWER_TIMEOUT: Final = 3.0
POLL: Final = 0.02


def system_option(function: Any) -> Any:
    """``--system``: needed only where several run."""
    return click.option(
        "--system",
        metavar="NAME",
        shell_complete=shell_completion.systems,
        help="The running system; needed only if several are running.",
    )(function)


def find(system: str | None) -> tuple[Client, Workspace]:
    """The manager of ``system``, or of the only running system.

    Raises NoManager if none is running, ManagerError if it does not answer, UsageError if several are running.
    """
    known = {workspace.name: workspace for workspace in Workspace.all()}
    if system is not None:
        workspace = _named(system, known)
        return answering(workspace), workspace
    if len(known) == 1:
        (only,) = known.values()
        return answering(only), only
    running = [workspace for workspace in known.values() if Client(workspace.socket).answers()]
    if len(running) > 1:
        names = ", ".join(workspace.name for workspace in running)
        raise click.UsageError(f"several systems are running ({names}); choose one with --system NAME")
    if running:
        return Client(running[0].socket), running[0]
    if known:
        raise NoManager(
            f"no manager answers; components of these systems may still be running: {', '.join(known)}. "
            "Choose one with --system NAME"
        )
    raise NoManager(f"no system is running: {_nothing_here()}; start one with `midstride up FILE`")


def _nothing_here() -> str:
    return f"none in {workspace_root()}, where those of this user and XDG_RUNTIME_DIR are"


def find_workspace(system: str | None) -> Workspace:
    """The workspace of a system, for what needs no manager, which may have exited."""
    known = {workspace.name: workspace for workspace in Workspace.all()}
    if system is not None:
        return _named(system, known)
    return next(iter(known.values())) if len(known) == 1 else find(None)[1]


def find_records(system: str | None) -> Workspace:
    """The workspace of a system with records: one that is down counts if it is named, or if none is up.

    A note on standard error says that it is down.
    """
    up = {workspace.name: workspace for workspace in Workspace.all()}
    if system in up or (system is None and up):
        return find_workspace(system)
    down = {workspace.name: workspace for workspace in Workspace.down()}
    if not down:
        return find_workspace(system)
    if system is None and len(down) > 1:
        names = ", ".join(down)
        raise click.UsageError(f"no system is running; of those that are down ({names}) choose one with --system NAME")
    found = next(iter(down.values())) if system is None else _named(system, {**up, **down})
    click.echo(f"({found.name} is down: this is what it has left)", err=True)
    return found


def not_running(status: Status, node: str) -> PlanRefused:
    """The error where no component of the ``status`` is or has the node: it has crashed, or was misspelt."""
    for crash in status.crashed:
        if crash.role and node in (crash.name, crash.role):
            return PlanRefused("; ".join(filter(None, [crash.words, crash.remedy])))
    known = [*(each.role for each in status.instances), *(each.role for each in status.crashed if each.role)]
    hint = in_file(status.file, nodes=[node]) or suggestion(node, sorted(set(known)))
    return PlanRefused(f"no node {node} is running" + (f"; {hint}" if hint else ""))


def in_file(file: str | None, *, nodes: Iterable[str] = (), components: Iterable[str] = ()) -> str | None:
    """Advise what to write for names that the running system lacks and ``file`` declares by now.

    ``file`` is the one that the system was brought up from, or that was applied last.
    """
    from midstride.cli.input_files import as_typed_here, load

    try:
        specification = None if file is None else load(Path(file))
    except (MidstrideError, OSError):  # it may be half written
        specification = None
    if file is None or specification is None:
        return None
    path = shlex.quote(as_typed_here(file))
    if names := [f"`{name}`" for name in components if name in specification.components]:
        return (
            f"{path} has {', '.join(names)}, which the running system does not know yet: add `--from {path}`, or "
            f"carry out all that the file changes with `midstride apply {path}`"
        )
    if names := [f"`{name}`" for name in nodes if name in specification.nodes]:
        which = f"{path} has {', '.join(names)}, which the running system does not know yet"
        return f"{which}: `midstride apply {path}` adds {'it' if len(names) == 1 else 'them'}"
    return None


def _named(system: str, known: Mapping[str, Workspace]) -> Workspace:
    if system not in known:
        hint = suggestion(system, known) or f"{_nothing_here()}; start it with `midstride up FILE`"
        raise NoManager(f"no system {system} is running; {hint}")
    return known[system]


def answering(workspace: Workspace) -> Client:
    """The manager of ``workspace``. Raises NoManager where it has exited, ManagerError where it does not answer."""
    client = Client(workspace.socket)
    end = time.monotonic() + ANSWER_TIMEOUT
    while not client.answers(max(POLL, end - time.monotonic())):
        if (manager := workspace.manager()) is None:
            raise NoManager(
                f"the manager of {workspace.name} has exited; its components may still be running: "
                "`midstride up FILE` reattaches to them, `midstride down` stops them"
            )
        if time.monotonic() > end:
            raise ManagerError(
                f"the manager of {workspace.name} (process {manager}) is running but does not answer. If this "
                f"persists, `kill -9 {manager}` ends the manager alone: its components keep running, and "
                "`midstride up FILE` reattaches to them"
            )
        time.sleep(POLL)
    return client
