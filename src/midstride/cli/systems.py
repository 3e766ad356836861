"""Which running system is meant."""

from __future__ import annotations

import time
from typing import Any, Final

import click

from midstride.cli.client import Client
from midstride.errors import ManagerError, NoManager
from midstride.model.diagnostics import suggestion
from midstride.runtime.workspace import Workspace

# How long a manager that does not answer may be about to begin, or to end (s).
PATIENCE: Final = 3.0
POLL: Final = 0.02


def system_option(function: Any) -> Any:
    """``--system``: needed only where several run."""
    return click.option(
        "--system", metavar="NAME", help="Which running system is meant; needed only where several run."
    )(function)


def find(system: str | None) -> tuple[Client, Workspace]:
    """The manager of ``system``, or of the one that runs.

    Raises NoManager where none does, ManagerError where it runs but does not answer, UsageError where it is not clear
    which is meant.
    """
    known = {workspace.name: workspace for workspace in Workspace.all()}
    if system is not None:
        if system not in known:
            hint = suggestion(system, known) or "start it with `midstride up FILE`"
            raise NoManager(f"no system {system} is running; {hint}")
        return _answering(known[system]), known[system]
    running = [workspace for workspace in known.values() if Client(workspace.socket).service() is not None]
    if len(running) > 1:
        names = ", ".join(workspace.name for workspace in running)
        raise click.UsageError(f"several systems are running ({names}): say which with --system NAME")
    if running:
        return Client(running[0].socket), running[0]
    if len(known) > 1:
        raise NoManager(
            f"no manager answers; components of these systems may still run: {', '.join(known)}. "
            "Say which is meant with --system NAME"
        )
    if known:
        (left,) = known.values()
        return _answering(left), left
    raise NoManager("no system is running; start one with `midstride up FILE`")


def _answering(workspace: Workspace) -> Client:
    client = Client(workspace.socket)
    end = time.monotonic() + PATIENCE
    while client.service() is None:
        if (manager := workspace.manager()) is None:
            raise _ended(workspace)
        if time.monotonic() > end:
            raise ManagerError(
                f"the manager of {workspace.name} (process {manager}) runs, but does not answer. Should that last, "
                f"`kill -9 {manager}` ends it alone: its components go on, and `midstride up FILE` finds them again"
            )
        time.sleep(POLL)
    return client


def _ended(workspace: Workspace) -> NoManager:
    return NoManager(
        f"the manager of {workspace.name} has ended, its components may still run: "
        "`midstride up` with its file finds them again, `midstride down` ends them"
    )
