"""The journal: what it keeps, what it does when the disk or the file fails, and who may write to it."""

from __future__ import annotations

import asyncio
import os
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Coroutine, Iterable
from contextlib import closing
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest

from midstride.errors import ManagerError, Superseded
from midstride.model.specification import Order, Specification
from midstride.plan.estimate import Estimate
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.records import journal_records
from midstride.runtime.records.change_history import ChangeRecord
from midstride.runtime.records.change_report import ChangeTimeline
from midstride.runtime.records.closed_journal import closed_history
from midstride.runtime.records.disk import Database, Disk, Statement
from midstride.runtime.records.journal import Journal
from midstride.runtime.records.journal_records import (
    CHANGES,
    EARLIER,
    INCIDENTS,
    VERSION,
    NewChange,
    require_readable,
)
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.reports import Event, Outcome
from tests.plan.cases import replaced
from tests.runtime.systems import example

FIRST = example("talker")
SECOND = FIRST.with_node(changed(FIRST.nodes["talker"], component="NewTalker"))
SWAP = SwapReport("/chatter", "listener.in", 0.1, 0.15, 1.5, 2, 0, 0)


def journal(path: Path, disk: Disk | None = None) -> Journal:
    return Journal(path / "journal.db", "sim", disk or Disk())


def run(body: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(body())


def new(after: Specification = SECOND, before: Specification | None = FIRST, steps: int = 2) -> NewChange:
    return NewChange("replace talker with NewTalker", "anna: replace", before, after, steps)


async def carried_out(found: Journal, change: NewChange | None = None, seconds: float = 0.5) -> None:
    entry = await found.begin(change or new())
    for words, estimates in (("create talker_2", "create NewTalker"), ("attach it", None)):
        await entry.step(words)
        entry.took(seconds, estimates)
    await entry.end("done", None, 2 * seconds)


async def changes(found: Journal) -> list[ChangeRecord]:
    return (await found.history(1000)).changes


# -- what is kept --------------------------------------------------------------------------------------


def test_a_change_is_in_the_history_with_its_steps_and_figures(tmp_path: Path) -> None:
    async def body() -> None:
        first = journal(tmp_path)
        await first.take_over()
        before = time.time()
        entry = await first.begin(new())
        await entry.step("create talker_2")
        [begun] = await changes(first)
        assert (begun.outcome, begun.version, begun.total) == (None, 1, 2)
        assert [(step.words, step.outcome) for step in begun.steps] == [("create talker_2", None)]
        entry.took(0.25, None)
        await entry.step("attach it")
        entry.took(0.5, None)
        await entry.end("done", None, 0.75)
        await entry.measured([SWAP, changed_swap(gap=0.3, missed=1)])
        first.close()
        [found] = await changes(journal(tmp_path))
        assert before <= found.at <= time.time()
        assert (found.number, found.command, found.by) == (1, "replace talker with NewTalker", "anna: replace")
        assert (found.outcome, found.because, found.seconds, found.version) == ("done", None, 0.75, 2)
        assert (found.missed, found.gap) == (3, 0.3)
        assert [(step.outcome, step.seconds) for step in found.steps] == [("done", 0.25), ("done", 0.5)]

    run(body)


def changed_swap(**values: Any) -> SwapReport:
    return SwapReport(**{name: getattr(SWAP, name) for name in SWAP.__struct_fields__} | values)


def test_a_figure_that_is_unknown_at_one_subscriber_is_unknown(tmp_path: Path) -> None:
    async def body() -> None:
        found = journal(tmp_path)
        entry = await found.begin(new())
        await entry.end("done", None, 1.0)
        await entry.measured([SWAP, changed_swap(gap=None, missed=None)])
        await carried_out(found)
        assert [(change.missed, change.gap) for change in await changes(found)] == [(None, None), (None, None)]

    run(body)


def test_a_step_that_fails_is_marked_before_the_roll_back(tmp_path: Path) -> None:
    async def body() -> None:
        found = journal(tmp_path)
        entry = await found.begin(new())
        await entry.step("create talker_2")
        assert await entry.failed()
        [change] = await changes(found)
        assert change.outcome is None and change.steps[0].outcome == "failed"
        await entry.end("rolled_back", "it exited", 0.1)
        [change] = await changes(found)
        assert (change.outcome, change.because, change.version) == ("rolled_back", "it exited", 1)
        assert change.steps[0].outcome == "failed"

    run(body)


def test_versions_of_the_specification_are_kept_once_and_found(tmp_path: Path) -> None:
    async def body() -> None:
        found = journal(tmp_path)
        with pytest.raises(ManagerError, match="no earlier version"):
            await found.specification()
        await carried_out(found, new(FIRST, None))
        with pytest.raises(ManagerError, match="no earlier version"):
            await found.specification()
        await carried_out(found)
        await carried_out(found, new(SECOND, SECOND))  # a restart
        assert [change.version for change in await changes(found)] == [1, 2, 2]
        earlier = await found.specification()
        assert (earlier.version, earlier.specification.specification()) == (1, FIRST)
        assert (await found.specification(2)).specification.specification() == SECOND
        await carried_out(found, new(FIRST, SECOND))
        assert (await found.specification()).version == 2
        with pytest.raises(ManagerError, match="no version 3"):
            await found.specification(3)

    run(body)


def test_after_down_the_version_before_is_the_one_that_ran_last(tmp_path: Path) -> None:
    async def body() -> None:
        first = journal(tmp_path)
        await carried_out(first, new(FIRST, None))
        first.close()
        again = journal(tmp_path)
        await carried_out(again, new(SECOND, None))
        assert (await again.specification()).specification.specification() == FIRST

    run(body)


def test_incidents_are_kept_and_other_events_are_not(tmp_path: Path) -> None:
    async def body() -> None:
        first = journal(tmp_path)
        first.note(Event(n=1, at=5.0, kind="exited", words="talker exited unexpectedly"))
        first.note(Event(n=2, at=6.0, kind="step", words="1/2 create talker"))
        first.close()  # before the task could write
        second = journal(tmp_path)
        second.note(Event(n=1, at=7.0, kind="degraded", words="listener.listen degraded"))
        await asyncio.sleep(0)
        while second._backlog:
            await asyncio.sleep(0.01)
        found = (await second.history(10)).incidents
        assert [(each.at, each.kind) for each in found] == [(5.0, "exited"), (7.0, "degraded")]
        second.close()

    run(body)


def test_what_no_text_can_express_is_kept_as_an_escape_and_is_no_damage(tmp_path: Path) -> None:
    """As a path that is not UTF-8, in the reason of a failure."""
    words = os.fsdecode(b"cannot start it: the folder /robots/f\xfcnf does not exist")
    kept = r"cannot start it: the folder /robots/f\udcfcnf does not exist"

    async def body() -> None:
        first = journal(tmp_path)
        await first.take_over()
        entry = await first.begin(new())
        await entry.step(words)
        first.note(Event(n=1, at=time.time(), kind="respawn_ended", words=words))
        await entry.end("rolled_back", words, 1.0)
        timeline = ChangeTimeline(since=0.0, until=1.0, modes=[], events=[])
        await entry.recorded(Outcome(outcome="rolled_back", because=words), timeline)
        first.close()
        again = journal(tmp_path)
        await again.take_over()
        history = await again.history(10)
        [found] = history.changes
        assert ([step.words for step in found.steps], found.because) == ([kept], kept)
        assert [incident.words for incident in history.incidents] == [kept]
        report = await again.report()
        assert report.outcome is not None and report.outcome.because == kept
        assert again.damaged is None
        again.close()

    run(body)


def test_durations_are_estimates_of_the_same_back_end(tmp_path: Path) -> None:
    async def body() -> None:
        first = journal(tmp_path)
        for seconds in (0.4, 9.0, 0.6):
            await carried_out(first, seconds=seconds)
        assert first.estimates == {"create NewTalker": Estimate(0.6, 0.4, 9.0)}, "one slow start does not count"
        first.close()
        second, other = journal(tmp_path), Journal(tmp_path / "journal.db", "ros2")
        await second.take_over()
        assert second.estimates == first.estimates
        await other.take_over()
        assert other.estimates == {}

    run(body)


def test_how_long_a_step_took_is_kept_in_whole_microseconds(tmp_path: Path) -> None:
    async def body() -> None:
        found = journal(tmp_path)
        await carried_out(found, seconds=0.12345678)
        [change] = await changes(found)
        assert [step.seconds for step in change.steps] == [0.123457, 0.123457]
        found.close()

    run(body)


# -- bounds --------------------------------------------------------------------------------------------


def rows(path: Path, table: str) -> int:
    with closing(sqlite3.connect(path / "journal.db")) as database, database:
        return int(database.execute(f"SELECT count(*) FROM {table}").fetchone()[0])


def test_old_entries_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (CHANGES, INCIDENTS) == (200, 2_000)
    for bound in ("CHANGES", "INCIDENTS", "DURATIONS"):
        monkeypatch.setattr(journal_records, bound, 3)

    async def body() -> None:
        found = journal(tmp_path)
        open_end = await found.begin(new())
        for number in range(10):
            found.note(Event(n=number, at=float(number), kind="exited", words=str(number)))
            await carried_out(found, new(SECOND if number > 2 else FIRST, SECOND if number > 3 else FIRST))
        numbers = [change.number for change in await changes(found)]
        assert numbers == [1, 9, 10, 11], "one that has not ended is kept"
        assert rows(tmp_path, "steps") == 6
        assert rows(tmp_path, "incidents") <= 4 and rows(tmp_path, "durations") <= 4
        await open_end.end("rolled_back", "late", 0.0)
        await carried_out(found, new(SECOND, SECOND))
        assert [change.number for change in await changes(found)] == [10, 11, 12]
        assert rows(tmp_path, "specifications") == 1

    run(body)


def test_old_incidents_are_removed_while_nothing_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_records, "INCIDENTS", 3)

    async def body() -> None:
        found = journal(tmp_path)
        for number in range(10):
            found.note(Event(n=number, at=float(number), kind="parameters", words=str(number)))
            await found.write()
        assert [each.words for each in (await found.history(100)).incidents] == ["7", "8", "9"]
        found.close()

    run(body)


def test_the_size_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    largest = 400_000
    monkeypatch.setattr(journal_records, "LARGEST", largest)

    async def body() -> None:
        found = journal(tmp_path)
        for _ in range(60):
            entry = await found.begin(new())
            await entry.step("x" * 50_000)
            await entry.end("done", None, 0.0)
        assert 1 < len(await changes(found)) < 20
        found.close()

    run(body)
    assert (tmp_path / "journal.db").stat().st_size < 2 * largest


# -- what was interrupted ------------------------------------------------------------------------------


def test_the_next_manager_finds_what_was_interrupted_and_where(tmp_path: Path) -> None:
    async def body() -> None:
        first = journal(tmp_path)
        await carried_out(first)
        entry = await first.begin(new(FIRST, SECOND, steps=7))
        await entry.step("create talker_3")
        first.close()
        second = journal(tmp_path)
        [found] = await second.take_over()
        assert (found.number, found.target, found.step) == (2, FIRST, 1)
        assert str(found) == "the manager ended during step 1 of 7"
        await second.end_interrupted(found, SECOND, ())
        assert [change.outcome for change in await changes(second)] == ["done", "rolled_back"]
        assert (await changes(second))[1].because == f"{found}; the next one has rolled it back"
        await second.end_interrupted(found, FIRST, ())
        assert (await changes(second))[1].because == f"{found}; the next one has finished it"
        await second.end_interrupted(found, None, ())
        last = (await changes(second))[1]
        assert (last.outcome, last.because) == ("failed", f"{found}; no component of the system was left")
        assert await journal(tmp_path).take_over() == []

    run(body)


@pytest.mark.parametrize(
    ("running", "outcome"), [(("talker",), "rolled_back"), (("talker_2",), "done"), (("talker", "talker_2"), "done")]
)
def test_an_interrupted_restart_is_done_only_if_what_it_created_runs(
    tmp_path: Path, running: tuple[str, ...], outcome: str
) -> None:
    async def body() -> None:
        first = journal(tmp_path)
        await carried_out(first)
        plan = PlanPreview.of(replaced(FIRST, "talker", "NewTalker", "minimal"))
        entry = await first.begin(changed(new(FIRST, FIRST, steps=7), plan=plan))
        await entry.step("create talker_2")
        first.close()
        second = journal(tmp_path)
        [found] = await second.take_over()
        assert found.created == {"talker_2"}
        await second.end_interrupted(found, FIRST, running)
        assert (await changes(second))[1].outcome == outcome

    run(body)


def test_what_was_interrupted_is_found_whatever_its_names_are(tmp_path: Path) -> None:
    async def body() -> None:
        target = changed(SECOND, constraints=(Order("talker", "no node"),))
        first = journal(tmp_path)
        await first.begin(new(target))
        first.close()
        [found] = await journal(tmp_path).take_over()
        assert found.target == target

    run(body)


def test_a_manager_whose_lease_another_has_taken_writes_nothing_more(tmp_path: Path) -> None:
    async def body() -> None:
        first, second = journal(tmp_path), journal(tmp_path)
        await first.take_over()
        entry = await first.begin(new())
        await second.take_over()
        with pytest.raises(Superseded, match="another manager of this system has taken over"):
            await entry.step("create talker_2")
        assert not await entry.failed()
        with pytest.raises(Superseded):
            await first.begin(new(), required=False)
        first.note(Event(n=1, at=1.0, kind="exited", words="talker"))
        first.close()
        await carried_out(second)
        assert [len(change.steps) for change in await changes(second)] == [0, 2]
        assert (await second.history(9)).incidents == []

    run(body)


# -- a disk that refuses, or is slow -------------------------------------------------------------------


class Unreliable(Disk):
    """Writes fail while ``full``, and take ``seconds`` each."""

    full = False
    seconds = 0.0

    def open(self, path: Path, schema: str) -> Database:
        return UnreliableDatabase(super().open(path, schema).connection, self)


class UnreliableDatabase(Database):
    def __init__(self, connection: sqlite3.Connection, disk: Unreliable) -> None:
        super().__init__(connection)
        self.disk = disk

    def write(self, statements: Iterable[Statement], only_if: Statement | None = None) -> None:
        assert self.disk.seconds == 0 or threading.current_thread() is not threading.main_thread()
        time.sleep(self.disk.seconds)
        if self.disk.full:
            raise sqlite3.OperationalError("database or disk is full")
        super().write(statements, only_if)


def test_a_change_that_cannot_be_recorded_is_not_begun(tmp_path: Path) -> None:
    async def body() -> None:
        disk = Unreliable()
        found = journal(tmp_path, disk)
        await found.take_over()
        disk.full = True
        with pytest.raises(ManagerError, match=r"journal\.db: database or disk is full"):
            await found.begin(new())
        assert "disk is full" in str(found.unwritten) and found.damaged is None
        entry = await found.begin(new(), required=False)  # to bring a system up again
        await entry.step("create talker")
        await entry.end("done", None, 1.0)
        disk.full = False
        await carried_out(found)
        assert found.unwritten is None
        assert [(change.number, len(change.steps)) for change in await changes(found)] == [(1, 2)]

    run(body)


def test_the_lease_is_taken_once_the_disk_has_room(tmp_path: Path) -> None:
    async def body() -> None:
        first, disk = journal(tmp_path), Unreliable()
        await first.take_over()
        disk.full = True
        second = journal(tmp_path, disk)
        assert await second.take_over() == [] and "disk is full" in str(second.unwritten)
        disk.full = False
        await carried_out(second)
        assert second.unwritten is None and len(await changes(second)) == 1
        with pytest.raises(Superseded):
            await first.begin(new())
        first.close()
        second.close()

    run(body)


def test_what_was_interrupted_is_found_on_a_full_disk_and_ended_once_it_has_room(tmp_path: Path) -> None:
    async def body() -> None:
        first, disk = journal(tmp_path), Unreliable()
        await carried_out(first)
        await (await first.begin(new(FIRST, SECOND))).step("create talker_3")
        first.close()
        disk.full = True
        second = journal(tmp_path, disk)
        [found] = await second.take_over()
        assert (found.number, found.step, second.estimates != {}) == (2, 1, True)
        await second.end_interrupted(found, SECOND, ())
        assert "disk is full" in str(second.unwritten) and (await changes(second))[1].outcome is None
        disk.full = False
        assert [change.outcome for change in await changes(second)] == ["done", "rolled_back"]
        assert second.unwritten is None
        second.close()

    run(body)


def test_what_the_disk_refuses_during_a_change_is_written_later(tmp_path: Path) -> None:
    async def body() -> None:
        disk = Unreliable()
        found = journal(tmp_path, disk)
        entry = await found.begin(new())
        await entry.step("create talker_2")
        disk.full = True
        entry.took(0.1, "create NewTalker")
        await entry.step("attach it")
        await entry.end("done", None, 1.0)
        assert "disk is full" in str(found.unwritten)
        disk.full = False
        found.note(Event(n=1, at=1.0, kind="exited", words="talker"))
        while found._backlog:
            await asyncio.sleep(0.01)
        [change] = await changes(found)
        assert change.outcome == "done" and [step.outcome for step in change.steps] == ["done", "done"]

    run(body)


def test_a_slow_disk_does_not_hold_up_the_event_loop(tmp_path: Path) -> None:
    async def body() -> None:
        disk = Unreliable()
        found = journal(tmp_path, disk)
        await found.take_over()
        disk.seconds = 0.2  # the database asserts that another thread waits
        ticks = 0

        async def tick() -> None:
            nonlocal ticks
            while True:
                await asyncio.sleep(0)
                ticks += 1

        ticking = asyncio.ensure_future(tick())
        entry = await found.begin(new())
        await entry.step("create talker_2")
        ticking.cancel()
        assert ticks > 10
        disk.seconds = 0.0
        found.close()

    run(body)


def test_what_is_being_written_is_in_the_file_when_it_is_closed_and_nothing_is_written_after(tmp_path: Path) -> None:
    async def body() -> None:
        disk = Unreliable()
        found = journal(tmp_path, disk)
        await found.take_over()
        entry = await found.begin(new())
        disk.seconds = 0.2
        writing = [asyncio.ensure_future(entry.step(words)) for words in ("create talker_2", "attach it")]
        await asyncio.sleep(0.05)
        for each in writing:  # one is in the thread, one waits for it
            each.cancel()
        await asyncio.gather(*writing, return_exceptions=True)
        found.close()
        disk.seconds = 0.0
        reader = journal(tmp_path)
        assert [step.words for step in (await changes(reader))[0].steps] == ["create talker_2", "attach it"]
        reader.close()
        shutil.rmtree(tmp_path)
        with pytest.raises(ManagerError, match="closed"):
            await entry.step("hand over")
        assert not tmp_path.exists()

    run(body)


# -- a file that is damaged ----------------------------------------------------------------------------


async def three_changes(path: Path) -> None:
    found = journal(path)
    await found.take_over()
    for _ in range(3):
        await carried_out(found)
    found.close()


def overwrite(start: int, content: bytes) -> Callable[[Path], object]:
    def damage(path: Path) -> None:
        with path.open("r+b") as file:
            file.seek(start)
            file.write(content)

    return damage


def statement(words: str) -> Callable[[Path], object]:
    def damage(path: Path) -> None:
        with closing(sqlite3.connect(path)) as database, database:
            database.execute(words)
        database.close()

    return damage


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no database": lambda path: path.write_bytes(b"{" * 5000),
    "its head": overwrite(0, b"\xff" * 200),
    "its pages": overwrite(4096, b"\xff" * 20_000),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:5000]),
    "no version": statement("UPDATE about SET value = 'one' WHERE key = 'version'"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_journal_is_named_and_kept_aside_and_a_new_one_begun(name: str, tmp_path: Path) -> None:
    async def body() -> None:
        await three_changes(tmp_path)
        path, aside = tmp_path / "journal.db", tmp_path / "journal.damaged.db"
        DAMAGES[name](path)
        content = path.read_bytes()
        found = journal(tmp_path)
        assert await found.take_over() == []
        assert found.unwritten is None
        assert str(found.damaged).startswith(f"the journal {path} was damaged (")
        assert str(found.damaged).endswith(f"): it is kept as {aside}, and a new one is begun")
        assert aside.read_bytes()[4096:] == content[4096:]
        assert (await found.history(9)).damaged == found.damaged and await changes(found) == []
        await carried_out(found)
        found.close()
        assert len(await changes(journal(tmp_path))) == 1

    run(body)


def of_version(version: str, folder: Path) -> None:
    statement(f"UPDATE about SET value = '{version}' WHERE key = 'version'")(folder / "journal.db")


def test_the_journal_of_a_newer_version_is_kept_aside_and_refused_where_asked_before(tmp_path: Path) -> None:
    async def body() -> None:
        require_readable(tmp_path / "journal.db")  # there is none yet
        await three_changes(tmp_path)
        require_readable(tmp_path / "journal.db")
        of_version("99", tmp_path)
        newer = f"a newer version of Midstride wrote it, in form 99, and this one reads up to {VERSION}"
        with pytest.raises(ManagerError, match=rf"^cannot use the journal {tmp_path}/journal.db: {newer}; use that"):
            require_readable(tmp_path / "journal.db")
        with pytest.raises(ManagerError, match=newer):
            closed_history(tmp_path / "journal.db", 9)
        found = journal(tmp_path)
        assert await found.take_over() == []
        aside = tmp_path / "journal.newer.db"
        assert found.damaged == (
            f"the journal {tmp_path}/journal.db cannot be used, as {newer}: it is kept as {aside}, and a new one is "
            "begun"
        )
        found.close()
        assert aside.exists() and await changes(journal(tmp_path)) == []

    run(body)


@pytest.mark.parametrize("version", sorted(EARLIER))
def test_the_journal_of_an_earlier_version_goes_on(version: str, tmp_path: Path) -> None:
    async def body() -> None:
        await three_changes(tmp_path)
        of_version(version, tmp_path)
        require_readable(tmp_path / "journal.db")
        assert len(closed_history(tmp_path / "journal.db", 9).changes) == 3
        found = journal(tmp_path)
        assert await found.take_over() == [] and found.damaged is None
        await carried_out(found)
        assert len(await changes(found)) == 4
        found.close()
        with closing(sqlite3.connect(tmp_path / "journal.db")) as database:
            rows = database.execute("SELECT value FROM about WHERE key = 'version'").fetchall()
        assert rows == [(VERSION,)]

    run(body)


@pytest.mark.parametrize(
    "words",
    [
        "UPDATE changes SET swaps = '[{\"topic\"' WHERE number = 2",
        "UPDATE changes SET outcome = 'perhaps' WHERE number = 2",
        "UPDATE changes SET at = 'yesterday' WHERE number = 2",
        "UPDATE steps SET words = x'ff' WHERE change = 2",
        "UPDATE steps SET seconds = 'long' WHERE change = 2",
    ],
)
def test_a_journal_with_a_damaged_row_is_not_read_by_half(words: str, tmp_path: Path) -> None:
    async def body() -> None:
        await three_changes(tmp_path)
        statement(words)(tmp_path / "journal.db")
        found = journal(tmp_path)
        await found.take_over()
        with pytest.raises(ManagerError, match=r"was damaged .*: it is kept as .*journal\.damaged\.db"):
            await found.history(9)
        assert found.unwritten == found.damaged is not None
        await carried_out(found)
        assert found.unwritten is None and len(await changes(found)) == 1

    run(body)


def test_damage_that_a_change_meets_refuses_it_and_the_next_one_is_recorded(tmp_path: Path) -> None:
    async def body() -> None:
        await three_changes(tmp_path)
        found = journal(tmp_path)
        await found.take_over()
        assert found._database is not None
        found._database.connection.execute("DROP TABLE specifications")
        with pytest.raises(ManagerError, match=r"no such table: specifications.*is kept as"):
            await found.begin(new())
        await carried_out(found)
        assert [change.number for change in await changes(found)] == [1]

    run(body)


def test_of_a_torn_journal_the_whole_transactions_are_read(tmp_path: Path) -> None:
    """The write-ahead log is cut at every 4 KB and a half: what is left are the first transactions, each whole."""

    async def body() -> None:
        whole = tmp_path / "whole"
        whole.mkdir()
        found = journal(whole)
        await found.take_over()
        for _ in range(3):
            await carried_out(found)
        log = (whole / "journal.db-wal").read_bytes()
        seen: list[tuple[int, int]] = []
        for number, cut in enumerate(range(2048, len(log), 4096)):
            torn = tmp_path / str(number)
            torn.mkdir()
            shutil.copy(whole / "journal.db", torn)
            (torn / "journal.db-wal").write_bytes(log[:cut] + b"\xff" * 1000)
            left = journal(torn)
            interrupted = await left.take_over()
            assert left.unwritten is None
            if left.damaged is not None:  # cut off inside of the first, which creates the tables
                assert "it has no version" in left.damaged or "no such table" in left.damaged
                continue
            kept = await changes(left)
            assert [change.number for change in kept] == list(range(1, len(kept) + 1))
            assert [change.number for change in kept if change.outcome is None] == [each.number for each in interrupted]
            assert all(len(change.steps) == 2 for change in kept if change.outcome == "done")
            seen.append((len(kept), sum(len(change.steps) for change in kept)))
            left.close()
        assert seen == sorted(seen) and seen[0] == (0, 0) and seen[-1][0] == 3
        found.close()

    run(body)


def test_a_version_that_is_not_valid_any_more_is_no_damage(tmp_path: Path) -> None:
    async def body() -> None:
        await three_changes(tmp_path)
        statement("UPDATE specifications SET form = '{\"system\": 5}' WHERE version = 1")(tmp_path / "journal.db")
        found = journal(tmp_path)
        await found.take_over()
        with pytest.raises(ManagerError, match="/system"):
            await found.specification(1)
        assert found.damaged is None and len(await changes(found)) == 3

    run(body)
