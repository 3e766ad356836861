"""The journal of a system: the intent of each step, durable before the step begins, and its outcome.

``state.db`` has what is true now, and is removed when the system is down; the journal, ``journal.db``, has what has
happened, and stays. From it the next manager knows which change was interrupted and where it led, people know what was
changed, when, and what it cost (`midstride history`), and the planner knows how long steps take. It also holds the
manager's lease: a manager whose lease another one has taken begins no further step. What runs is not taken from the
journal, but from the components (docs/protocols/journal.md).
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Collection, Container, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from midstride.errors import ManagerError, MidstrideError, Superseded
from midstride.model.specification import Specification
from midstride.plan.estimate import Estimate
from midstride.runtime.records import journal_records
from midstride.runtime.records.change_history import History, SpecificationVersion, read_history, read_specification
from midstride.runtime.records.change_report import ChangeReport, ChangeTimeline, existing, read_report, recorded
from midstride.runtime.records.disk import DISK, Database, Disk, Lease, Statement, refused
from midstride.runtime.records.journal_records import Interrupted, NewChange
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.reports import Event, Outcome, OutcomeKind

T = TypeVar("T")

# The kinds of events that are incidents.
INCIDENTS: Final = frozenset(
    """up down lock unlock forbidden override finished_despite exited killed left_out half_done silence
    silence_ended host fenced degraded restore restore_ended respawn respawn_ended parameters rollback_failed""".split()
)
# How many statements are kept in memory while the disk refuses them.
BACKLOG: Final = 2_000


class Journal:
    """The journal in ``path``. Its coroutines write in a thread: a slow disk must not delay the event loop.

    ``unwritten`` says why the last write failed, ``damaged`` where a damaged journal is kept. ``estimates``: how long
    steps take, by kind, or by kind and component (``create Talker``).
    """

    def __init__(self, path: Path, backend: str, disk: Disk = DISK) -> None:
        self.path = path
        self.unwritten: str | None = None
        self.damaged: str | None = None
        self.estimates: dict[str, Estimate] = {}
        self._backend = backend
        self._disk = disk
        self._database: Database | None = None
        self._lease = Lease("about")
        self._backlog: list[Statement] = []
        self._flushing: asyncio.Task[None] | None = None
        self._writer = ThreadPoolExecutor(1, "journal")  # one thread: writes happen in order
        self._closed = False

    @property
    def superseded(self) -> bool:
        """Another manager of the system has taken the lease."""
        return self._lease.superseded(self._database)

    async def take_over(self) -> list[Interrupted]:
        """Take the lease, with a later write if the disk refuses it; returns what was interrupted, oldest first.

        Raises nothing: without a journal, a running system can be recovered, too. ``unwritten`` then says why.
        """

        def read(database: Database) -> list[Interrupted]:
            self.estimates = journal_records.estimates(database, self._backend)
            return journal_records.interrupted(database)

        await self.write()
        try:
            return await self._beside(read)
        except ManagerError:
            return []

    def close(self) -> None:
        """Write what is left, if the disk takes it. Nothing is written after this returns."""
        self._closed = True
        if self._flushing is not None:
            self._flushing.cancel()
        self._writer.shutdown()  # waits for the writes that have begun, including those whose caller was cancelled
        with suppress(Superseded):
            if self._backlog:
                self._write(())
        self._disconnect()

    # -- writing -----------------------------------------------------------------------------------------

    async def begin(self, change: NewChange, *, required: bool = True) -> JournalEntry:
        """Record that ``change`` is about to begin. Raises Superseded; if it is ``required``, ManagerError."""

        def begin(database: Database) -> int:
            number, statements = journal_records.beginning(database, change)
            self._commit(database, statements)
            return number

        try:
            return JournalEntry(self, await self._beside(begin))
        except ManagerError as error:
            if required or isinstance(error, Superseded):
                raise
            return JournalEntry(self, None)

    async def end_interrupted(
        self, interrupted: Interrupted, specification: Specification | None, instances: Container[str]
    ) -> None:
        """An interrupted change has been finished, if its target and what it created run, or else rolled back.

        ``specification`` and ``instances`` are what runs; None: no component was left.
        """
        outcome, words = "rolled_back", f"{interrupted}; the next one has rolled it back"
        if specification is None:
            outcome, words = "failed", f"{interrupted}; no component of the system was left"
        elif interrupted.finished(specification, instances):
            outcome, words = "done", f"{interrupted}; the next one has finished it"
        update = "UPDATE changes SET outcome = ?, because = ? WHERE number = ?"
        await self.write((update, (outcome, words, interrupted.number)))

    def note(self, event: Event) -> None:
        """Keep ``event`` if it is an incident: it is written soon, and the caller does not wait."""
        if self._closed or event.kind not in INCIDENTS:
            return
        insert = "INSERT INTO incidents (at, kind, words) VALUES (?, ?, ?)"
        self._backlog.append((insert, (event.at, event.kind, event.words)))
        if self._flushing is None or self._flushing.done():
            self._flushing = asyncio.get_running_loop().create_task(self._flush())

    async def _flush(self) -> None:
        """Write the incidents that wait; once another manager has the lease, they are not kept."""
        try:
            await self.write()
        except Superseded:
            self._backlog.clear()

    async def write(self, *statements: Statement) -> None:
        """Write ``statements``: now, or with a later write if the disk refuses them.

        Raises Superseded, and ManagerError if the journal is closed.
        """
        await self._on_thread(lambda: self._write(statements))

    def _write(self, statements: Sequence[Statement]) -> None:
        try:
            self._on_database(lambda database: self._commit(database, statements))
        except Superseded:
            raise
        except ManagerError:
            self._backlog += statements
            del self._backlog[:-BACKLOG]

    def _commit(self, database: Database, statements: Sequence[Statement]) -> None:
        waiting = self._backlog[:]
        removal = [journal_records.removal_of_incidents()] if waiting else []
        self._lease.write(database, [*waiting, *removal, *statements])
        del self._backlog[: len(waiting)]
        self.unwritten = None

    async def keep_durations(self, durations: Sequence[tuple[str, float]]) -> None:
        """Use these durations of steps (s) for the next estimates."""
        insert = "INSERT INTO durations (backend, step, seconds) VALUES (?, ?, ?)"
        await self.write(*((insert, (self._backend, step, seconds)) for step, seconds in durations))
        with suppress(ManagerError):
            self.estimates = await self._beside(lambda database: journal_records.estimates(database, self._backend))

    # -- reading -----------------------------------------------------------------------------------------

    async def history(self, latest: int) -> History:
        """The latest changes and incidents. Raises ManagerError if they cannot be read."""
        await self._flush()
        return await self._beside(lambda database: read_history(database, latest, self.damaged))

    async def report(self, number: int | None = None) -> ChangeReport:
        """Change ``number``, by default the latest. Raises ManagerError if there is none, or it cannot be read."""
        await self._flush()
        return existing(await self._beside(lambda database: read_report(database, number)), number)

    async def specification(self, version: int | None = None) -> SpecificationVersion:
        """A version of the specification, by default the one before the latest change of it.

        Raises ManagerError if there is none, or it cannot be read.
        """
        found = await self._beside(lambda database: read_specification(database, version))
        if found is None:
            which = "no earlier version" if version is None else f"no version {version}"
            raise ManagerError(f"the history has {which} of the specification; `midstride history` lists them")
        return found

    # -- the file ----------------------------------------------------------------------------------------

    async def _beside(self, use: Callable[[Database], T]) -> T:
        return await self._on_thread(lambda: self._on_database(use))

    async def _on_thread(self, work: Callable[[], T]) -> T:
        if self._closed:
            raise ManagerError(f"the journal {self.path} is closed")
        # What is to be recorded is recorded, also if the caller is cancelled.
        return await asyncio.shield(asyncio.get_running_loop().run_in_executor(self._writer, work))

    def _on_database(self, use: Callable[[Database], T]) -> T:
        """Use the database, and return the result of ``use``. A damaged journal is kept aside.

        Raises ManagerError, and sets ``unwritten``.
        """
        try:
            return use(self._open())
        except Superseded:
            raise
        except journal_records.FAILURES as error:
            self.unwritten = f"cannot use the journal {self.path}: {error}"
            if _is_damage(error):
                self.unwritten = self._keep_aside(error)
            raise ManagerError(self.unwritten) from error

    def _open(self) -> Database:
        if self._database is None:
            try:
                self._connect()
            except sqlite3.DatabaseError as error:
                if not _is_damage(error):
                    raise
                self._keep_aside(error)
                self._connect()
        assert self._database is not None
        return self._database

    def _connect(self) -> None:
        self._database = database = self._disk.open(self.path, journal_records.SCHEMA)
        found = database.read("PRAGMA quick_check(1)")[0][0]
        if found != "ok":
            raise sqlite3.DatabaseError(found)
        journal_records.bring_forward(database)

    def _disconnect(self) -> None:
        if self._database is not None:
            self._database.close()
            self._database = None

    def _keep_aside(self, error: Exception) -> str:
        self._disconnect()
        self._lease.renew()
        newer = isinstance(error, journal_records.NewerJournal)
        aside = self._disk.set_aside(self.path, "newer" if newer else "damaged")
        why = f"cannot be used, as {error}" if newer else f"was damaged ({error})"
        self.damaged = f"the journal {self.path} {why}: it is kept as {aside}, and a new one is begun"
        return self.damaged


def _is_damage(error: Exception) -> bool:
    """Return whether the file is damaged: a full disk is no damage, nor a specification that is not valid any more."""
    return not refused(error) and not isinstance(error, MidstrideError)


@dataclass(slots=True)
class JournalEntry:
    """The record of one change while it is carried out; without ``number``, nothing is recorded."""

    journal: Journal
    number: int | None
    _steps: range = range(0)  # those that were begun last
    _seconds: dict[int, float] = field(default_factory=dict)  # how long those of them took that are done
    _durations: list[tuple[str, float]] = field(default_factory=list)

    async def step(self, *words: str) -> None:
        """The next steps are about to begin, at once: returns when this is durable. Raises Superseded."""
        if self.number is None:
            return
        before = self._end_of_steps("done")
        self._steps, self._seconds = range(self._steps.stop, self._steps.stop + len(words)), {}
        insert = "INSERT INTO steps (change, number, words) VALUES (?, ?, ?)"
        rows = ((self.number, step + 1, each) for step, each in zip(self._steps, words, strict=True))
        await self.journal.write(*before, *((insert, row) for row in rows))

    async def require_lease(self) -> None:
        """Raises Superseded if another manager has taken over. A disk that refuses everything cannot tell."""
        await self.journal.write()

    def took(self, seconds: float, estimates: str | None, place: int = 0) -> None:
        """A step is done, the one at ``place`` of those that were begun last; that is recorded with the next ones.

        ``estimates``: the key of the estimate, if any.
        """
        if self.number is not None:
            self._seconds[self._steps[place]] = round(seconds, 6)
        if estimates is not None:
            self._durations.append((estimates, seconds))

    async def failed(self, places: Collection[int] = (0,)) -> bool:
        """The steps at ``places`` have failed, and what is done is to be rolled back.

        False if another manager has taken over.
        """
        try:
            await self.journal.write(*self._end_of_steps("failed", places))
        except Superseded:
            return False
        return True

    async def end(self, outcome: OutcomeKind, because: str | None, seconds: float | None) -> None:
        """The change has ended."""
        if self.number is None:
            return
        update = "UPDATE changes SET outcome = ?, because = ?, seconds = ? WHERE number = ?"
        last = self._end_of_steps("done") if outcome == "done" else []
        await self.journal.write(*last, (update, (outcome, because, seconds, self.number)))
        if outcome == "done" and self._durations:
            await self.journal.keep_durations(self._durations)

    async def measured(self, swaps: Sequence[SwapReport]) -> None:
        """Note the figures of subscribers."""
        if self.number is not None and swaps:
            form = msgspec.json.encode(list(swaps)).decode()
            await self.journal.write(("UPDATE changes SET swaps = ? WHERE number = ?", (form, self.number)))

    async def recorded(self, outcome: Outcome, timeline: ChangeTimeline) -> None:
        """The change was reported so, and this happened meanwhile."""
        if self.number is not None:
            await self.journal.write(recorded(self.number, outcome, timeline))

    def _end_of_steps(self, outcome: OutcomeKind, places: Collection[int] = ()) -> list[Statement]:
        """The statements for the steps begun last: ``outcome`` for those at ``places`` and those that are not done."""
        update = "UPDATE steps SET outcome = ?, seconds = ? WHERE change = ? AND number = ?"
        statements: list[Statement] = []
        for place, step in enumerate(self._steps):
            seconds = self._seconds.get(step)
            ended = outcome if place in places or seconds is None else "done"
            statements.append((update, (ended, seconds, self.number, step + 1)))
        return statements
