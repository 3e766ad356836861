"""The history of a system, as it goes out in JSON: its changes with their figures, and the incidents between them."""

from __future__ import annotations

from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from midstride.codec.form import Report
from midstride.codec.specification_form import SpecificationForm, decode_specification
from midstride.runtime.records.disk import Database
from midstride.runtime.records.journal_records import IN_FORCE
from midstride.runtime.records.measure import SwapReport, longest_gap, missed_messages
from midstride.runtime.records.reports import OutcomeKind
from midstride.verdicts.assessment import Assessments

_COLUMNS: Final = f"number, at, command, by, total, {IN_FORCE} AS version, outcome, because, seconds, swaps"
# What the report of a change says of its continuity, where it was recorded.
_CONTINUITY: Final = "SELECT json_extract(outcome, '$.continuity') FROM records WHERE change = ?"
_CHANGES: Final = f"SELECT {_COLUMNS} FROM changes ORDER BY number DESC LIMIT ?"
_CHANGE: Final = f"SELECT {_COLUMNS} FROM changes WHERE number = ?"
_FIELDS: Final = ("number", "at", "command", "by", "total", "version", "outcome", "because", "seconds")
_PREVIOUS: Final = "SELECT before FROM changes WHERE outcome = 'done' AND before <> after ORDER BY number DESC LIMIT 1"


class StepRecord(Report, frozen=True):
    """A step that was begun; without an outcome, its end is not recorded."""

    words: str
    outcome: OutcomeKind | None
    seconds: float | None


class ChangeRecord(Report, frozen=True, kw_only=True):
    """A change; without an outcome, it is in progress."""

    number: int
    at: Annotated[float, Meta(description="when it began, in unix seconds")]
    command: str
    by: Annotated[str | None, Meta(description="who asked for it, in the client's words")]
    total: Annotated[int, Meta(description="how many steps its plan has")]
    steps: Annotated[list[StepRecord], Meta(description="those that were begun")]
    version: Annotated[int, Meta(description="of the specification that is in force afterwards")]
    outcome: OutcomeKind | None
    because: str | None
    seconds: float | None
    gap: Annotated[float | None, Meta(description="the longest, in seconds; null where it is unknown")]
    missed: Annotated[int | None, Meta(description="messages, at all subscribers; null where it is unknown")]
    swaps: Annotated[list[SwapReport], Meta(description="what was measured at each subscriber")]
    continuity: Annotated[
        Assessments | None, Meta(description="what was kept, what was lost, and what is not measurable; null: unknown")
    ] = None


class Incident(Report, frozen=True):
    """An event besides changes, such as an instance that exited."""

    at: float
    kind: str
    words: str


class History(Report, frozen=True):
    """The latest changes, oldest first, and the incidents since the first of them."""

    changes: list[ChangeRecord]
    incidents: list[Incident]
    damaged: Annotated[str | None, Meta(description="where an earlier history is kept that could not be read")]


class SpecificationVersion(Report, frozen=True):
    """A version of the specification."""

    version: int
    specification: SpecificationForm


def read_history(database: Database, latest: int, damaged: str | None) -> History:
    """The ``latest`` changes and incidents. Raises sqlite3.Error, or ValueError where a row is damaged."""
    changes = [_change(database, row) for row in reversed(database.read(_CHANGES, latest))]
    since = changes[0]["at"] if changes else 0.0
    query = "SELECT at, kind, words FROM incidents WHERE at >= ? ORDER BY number DESC LIMIT ?"
    incidents = [_named(("at", "kind", "words"), row) for row in reversed(database.read(query, since, latest))]
    return msgspec.convert({"changes": changes, "incidents": incidents, "damaged": damaged}, History)


def read_change(database: Database, number: int | None) -> ChangeRecord | None:
    """One change; None if there is none of that number. Raises as :func:`read_history` does."""
    rows = database.read(_CHANGE, number)
    return msgspec.convert(_change(database, rows[0]), ChangeRecord) if rows else None


def read_incidents(database: Database, since: float, until: float) -> list[Incident]:
    """The incidents between two times (unix seconds), oldest first."""
    query = "SELECT at, kind, words FROM incidents WHERE at >= ? AND at <= ? ORDER BY number"
    return [Incident(*row) for row in database.read(query, since, until)]


def _change(database: Database, row: tuple[Any, ...]) -> dict[str, Any]:
    found = _named(_FIELDS, row)
    swaps = msgspec.json.decode(row[-1] or "[]", type=list[SwapReport])
    query = "SELECT words, outcome, seconds FROM steps WHERE change = ? ORDER BY number"
    found["steps"] = [_named(("words", "outcome", "seconds"), step) for step in database.read(query, found["number"])]
    found["gap"], found["missed"] = longest_gap(swaps), missed_messages(swaps)
    (said,) = next(iter(database.read(_CONTINUITY, found["number"])), (None,))
    return found | {"swaps": msgspec.to_builtins(swaps), "continuity": msgspec.json.decode(said) if said else None}


def _named(names: tuple[str, ...], row: tuple[Any, ...]) -> dict[str, Any]:
    return dict(zip(names, row, strict=False))


def read_specification(database: Database, version: int | None) -> SpecificationVersion | None:
    """A version, by default the one before the latest change of the specification; None if it is not kept.

    Raises sqlite3.Error, ValueError where it is damaged, SpecificationError where it is not valid (any more).
    """
    if version is None:
        found = database.read(_PREVIOUS)
        version = found[0][0] if found else None
    for (form,) in database.read("SELECT form FROM specifications WHERE version = ?", version):
        checked = decode_specification(msgspec.json.decode(form))
        return SpecificationVersion(int(version or 0), SpecificationForm.of(checked))
    return None
