"""The tables of the journal, and what is written to and read from them (:mod:`.journal`).

Bounded: the latest 200 changes, 2,000 incidents and 2,000 durations. Where more than 16 MB are in use, the older half
of the changes is removed when the next one begins.
"""

from __future__ import annotations

import hashlib
import sqlite3
import time
from collections.abc import Container
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from midstride.codec.parameter import from_json
from midstride.codec.specification_form import SpecificationForm, decode_saved_specification
from midstride.errors import ManagerError, MidstrideError
from midstride.model.specification import Specification
from midstride.plan.estimate import Estimate
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.runtime_values import Values
from midstride.runtime.records.disk import DISK, Database, Statement

# What is raised where the journal cannot be used: by the disk, and by what is in the file.
FAILURES: Final = (sqlite3.Error, OSError, MidstrideError, ValueError, TypeError, RecursionError)
VERSION: Final = "2"
# The versions whose tables are the same; what differs in a row is read as far as it can be.
EARLIER: Final = frozenset({"1"})
CHANGES: Final = 200
INCIDENTS: Final = 2_000
DURATIONS: Final = 2_000
LARGEST: Final = 16 * 1024 * 1024  # bytes in use
# An estimate is the median of the latest durations of a step, this many at most.
SAMPLES: Final = 9
SCHEMA: Final = f"""
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
INSERT OR IGNORE INTO about VALUES ('version', '{VERSION}');
CREATE TABLE IF NOT EXISTS specifications (
    version INTEGER PRIMARY KEY AUTOINCREMENT, digest TEXT UNIQUE NOT NULL, form TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS changes (
    number INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL, command TEXT NOT NULL, by TEXT, total INTEGER NOT NULL,
    before INTEGER NOT NULL, after INTEGER NOT NULL, outcome TEXT, because TEXT, seconds REAL, swaps TEXT
);
CREATE TABLE IF NOT EXISTS steps (
    change INTEGER, number INTEGER, words TEXT NOT NULL, outcome TEXT, seconds REAL, PRIMARY KEY (change, number)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS records (change INTEGER PRIMARY KEY, plan TEXT, outcome TEXT, timeline TEXT);
CREATE TABLE IF NOT EXISTS incidents (
    number INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL, kind TEXT NOT NULL, words TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS durations (
    number INTEGER PRIMARY KEY AUTOINCREMENT, backend TEXT NOT NULL, step TEXT NOT NULL, seconds REAL NOT NULL
);
"""
# The version of the specification in force after a change.
IN_FORCE: Final = "CASE WHEN outcome IN ('done', 'incomplete') THEN after ELSE before END"
_REFERENCED: Final = "SELECT before FROM changes UNION SELECT after FROM changes"


@dataclass(frozen=True, slots=True)
class NewChange:
    """A change that is about to begin: ``steps`` is their number, ``before`` None where no system runs yet."""

    command: str
    by: str | None
    before: Specification | None
    after: Specification
    steps: int
    plan: PlanPreview | None = None


@dataclass(frozen=True, slots=True)
class Interrupted:
    """A change that an earlier manager began, and did not end.

    ``step`` is the number of the last step that was begun, ``since`` that of the first which had not ended.
    ``created``: the instances that it was to create. ``same``: it left the specification as it was, such as a restart.
    ``settings``: the values before of the parameters that it was to set at run time, by instance.
    """

    number: int
    command: str
    steps: int
    target: Specification
    step: int | None
    since: int | None
    created: frozenset[str] = frozenset()
    same: bool = False
    settings: tuple[tuple[str, Values], ...] = ()

    def finished(self, specification: Specification, instances: Container[str]) -> bool:
        """Return whether it has been finished, where ``specification`` and ``instances`` run now."""
        if self.settings:  # it was watched to its end, or is rolled back
            return False
        return specification == self.target and (not self.same or all(name in instances for name in self.created))

    def __str__(self) -> str:
        if self.step is None:
            return "the manager ended before the first step"
        several = f"s {self.since} to {self.step}" if self.since not in (None, self.step) else f" {self.step}"
        return f"the manager ended during step{several} of {self.steps}"


class NewerJournal(sqlite3.DatabaseError):
    """A newer version of Midstride wrote the journal."""


def check_version(database: Database) -> None:
    """Raises NewerJournal, and sqlite3.DatabaseError for a file that is no journal."""
    found = database.read("SELECT value FROM about WHERE key = 'version'")
    version = str(found[0][0]) if found else ""
    if version == VERSION or version in EARLIER:
        return
    if not version.isdecimal() or int(version) < int(VERSION):
        raise sqlite3.DatabaseError("it has no version of a journal")
    raise NewerJournal(f"a newer version of Midstride wrote it, in form {version}, and this one reads up to {VERSION}")


def bring_forward(database: Database) -> None:
    """Make a journal of an earlier version one of this. Raises as :func:`check_version` does, and if it is refused."""
    check_version(database)
    earlier = ", ".join(f"'{version}'" for version in sorted(EARLIER))
    database.write([(f"UPDATE about SET value = ? WHERE key = 'version' AND value IN ({earlier})", (VERSION,))])


def require_readable(path: Path) -> None:
    """Raises ManagerError where a newer version of Midstride wrote the journal at ``path``; one may be missing."""
    try:
        database = DISK.read_only(path)
        if database is not None:
            with closing(database):
                check_version(database)
    except NewerJournal as error:
        raise ManagerError(f"cannot use the journal {path}: {error}; use that version") from error
    except FAILURES:  # a damaged one is kept aside
        pass


def beginning(database: Database, change: NewChange) -> tuple[int, list[Statement]]:
    """The number of a new change, and the statements that record it and remove what is too old."""
    last = {name: int(number) for name, number in database.read("SELECT name, seq FROM sqlite_sequence")}
    versions = {digest: int(version) for digest, version in database.read("SELECT digest, version FROM specifications")}
    statements: list[Statement] = []

    def version(specification: Specification) -> int:
        form = msgspec.json.encode(SpecificationForm.of(specification)).decode()
        digest = hashlib.sha256(form.encode()).hexdigest()
        if digest not in versions:
            versions[digest] = last["specifications"] = last.get("specifications", 0) + 1
            statements.append(("INSERT INTO specifications VALUES (?, ?, ?)", (versions[digest], digest, form)))
        return versions[digest]

    number = last.get("changes", 0) + 1
    if change.before is not None:
        before, after = version(change.before), version(change.after)
    else:
        after = version(change.after)
        found = database.read(f"SELECT {IN_FORCE} FROM changes ORDER BY number DESC LIMIT 1")
        before = int(found[0][0]) if found else after  # what ran last, if anything did
    row = (number, time.time(), change.command, change.by, change.steps, before, after)
    insert = "INSERT INTO changes (number, at, command, by, total, before, after) VALUES (?, ?, ?, ?, ?, ?, ?)"
    statements.append((insert, row))
    if change.plan is not None:
        plan = msgspec.json.encode(change.plan).decode()
        statements.append(("INSERT INTO records (change, plan) VALUES (?, ?)", (number, plan)))
    return number, [*statements, *_removals(database, number)]


def _removals(database: Database, number: int) -> list[Statement]:
    kept = CHANGES
    pages, free, size = (
        database.read(f"PRAGMA {name}")[0][0] for name in ("page_count", "freelist_count", "page_size")
    )
    if (pages - free) * size > LARGEST:
        kept = min(kept, database.read("SELECT count(*) FROM changes")[0][0] // 2 + 1)
    return [
        ("DELETE FROM changes WHERE number <= ? AND outcome IS NOT NULL", (number - kept,)),
        ("DELETE FROM steps WHERE change NOT IN (SELECT number FROM changes)", ()),
        ("DELETE FROM records WHERE change NOT IN (SELECT number FROM changes)", ()),
        (f"DELETE FROM specifications WHERE version NOT IN ({_REFERENCED})", ()),
        removal_of_incidents(),
        ("DELETE FROM durations WHERE number <= (SELECT max(number) FROM durations) - ?", (DURATIONS,)),
    ]


def removal_of_incidents() -> Statement:
    """Removes those that are too old: they come without a change as well, as many as a program causes."""
    return "DELETE FROM incidents WHERE number <= (SELECT max(number) FROM incidents) - ?", (INCIDENTS,)


def interrupted(database: Database) -> list[Interrupted]:
    """The changes that were begun and have not ended, oldest first.

    Raises as :func:`decode_saved_specification` does.
    """
    query = """
    SELECT changes.number, command, total, form, (SELECT max(number) FROM steps WHERE change = changes.number),
        (SELECT min(number) FROM steps WHERE change = changes.number AND outcome IS NULL), before = after,
        (SELECT plan FROM records WHERE change = changes.number)
    FROM changes JOIN specifications ON version = after WHERE outcome IS NULL ORDER BY changes.number
    """
    return [
        Interrupted(
            number,
            command,
            steps,
            decode_saved_specification(msgspec.json.decode(form)),
            step,
            since,
            _created(plan),
            bool(same),
            _settings(plan),
        )
        for number, command, steps, form, step, since, same, plan in database.read(query)
    ]


class _Step(msgspec.Struct):
    action: str
    instance: str = ""
    before: dict[str, Any] | None = None


class _Plan(msgspec.Struct):
    steps: list[_Step] = []


def _steps(plan: str | None) -> list[_Step]:
    """The steps of a recorded plan; none where another version has recorded it otherwise."""
    try:
        return msgspec.json.decode(plan or "{}", type=_Plan).steps
    except msgspec.DecodeError:
        return []


def _created(plan: str | None) -> frozenset[str]:
    """The instances that a recorded plan creates."""
    return frozenset(step.instance for step in _steps(plan) if step.action == "create")


def _settings(plan: str | None) -> tuple[tuple[str, Values], ...]:
    """The values before of the parameters that a recorded plan sets at run time, by instance."""
    steps = ((step.instance, step.before) for step in _steps(plan) if step.action == "set")
    found = ((instance, before) for instance, before in steps if before)
    return tuple((name, {each: from_json(value) for each, value in before.items()}) for name, before in found)


def estimates(database: Database, backend: str) -> dict[str, Estimate]:
    """The time that each kind of step takes."""
    found: dict[str, list[float]] = {}
    query = "SELECT step, seconds FROM durations WHERE backend = ? ORDER BY number DESC"
    for step, seconds in database.read(query, backend):
        if len(samples := found.setdefault(step, [])) < SAMPLES:
            samples.append(seconds)
    return {step: Estimate.of(samples) for step, samples in found.items()}
