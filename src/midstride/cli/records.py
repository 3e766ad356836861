"""The records of a system: asked of its manager, or read from its files where it has none."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import click

from midstride.cli.client import READ_TIMEOUT, Client
from midstride.cli.running_systems import answering, find_records
from midstride.errors import NoManager
from midstride.runtime.workspace import Workspace

if TYPE_CHECKING:
    from midstride.runtime.records.change_history import History
    from midstride.runtime.records.change_report import ChangeReport


def history(system: str | None, latest: int) -> tuple[History, bool]:
    """The ``latest`` changes and incidents, and whether a manager continues them. Raises as :func:`change` does."""
    workspace = find_records(system)
    if (manager := _manager(workspace)) is not None:
        return manager.history(latest), True
    from midstride.runtime.records.closed_journal import closed_history

    return closed_history(workspace.journal, latest), False


def change(system: str | None, number: int | None) -> ChangeReport:
    """Change ``number`` of the history, by default the latest, with all that was recorded of it.

    Raises NoManager where no system is or was there, ManagerError where there is no such change or it cannot be read.
    """
    workspace = find_records(system)
    if (manager := _manager(workspace)) is not None:
        return manager.change_report(number)
    from midstride.runtime.records.closed_journal import closed_report

    return closed_report(workspace.journal, number)


def report(system: str | None, number: int | None) -> str:
    """The report of a change as an HTML file."""
    workspace = find_records(system)
    if (manager := _manager(workspace)) is not None:
        return manager.text("/report", timeout=3 * READ_TIMEOUT, number=number)
    from midstride.runtime.records.closed_journal import closed_report
    from midstride.server.report.documents import change_file

    return change_file(closed_report(workspace.journal, number), workspace.name)


def _manager(workspace: Workspace) -> Client | None:
    """None where it has exited, with a note on standard error unless the system is down."""
    if workspace.manager() is not None:
        with suppress(NoManager):
            return answering(workspace)
    if workspace.state.exists():
        words = f"the manager of {workspace.name} has exited: this is what it had recorded"
        click.echo(f"({words}; `midstride up FILE` reattaches to its components)", err=True)
    return None
