"""The journal of a system that has no manager, read from its file: what happened before its manager ended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from midstride.errors import ManagerError
from midstride.runtime.records import journal_records
from midstride.runtime.records.change_history import History, read_history
from midstride.runtime.records.change_report import ChangeReport, existing, read_report
from midstride.runtime.records.disk import DISK, Database

T = TypeVar("T")


def closed_history(path: Path, latest: int) -> History:
    """The ``latest`` changes and incidents. Raises ManagerError if they cannot be read."""
    return _read(path, lambda database: read_history(database, latest, None))


def closed_report(path: Path, number: int | None) -> ChangeReport:
    """Change ``number``, by default the latest. Raises ManagerError if there is none, or it cannot be read."""
    return existing(_read(path, lambda database: read_report(database, number)), number)


def _read(path: Path, use: Callable[[Database], T]) -> T:
    try:
        database = DISK.read_only(path)
        if database is None:
            raise ManagerError("there is no such file")
        try:
            journal_records.check_version(database)
            return use(database)
        finally:
            database.close()
    except journal_records.FAILURES as error:
        raise ManagerError(f"cannot read the journal {path}: {error}") from error
