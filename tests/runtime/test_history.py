"""The history of a running system: what its manager records, and what becomes of changes that cannot be recorded."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError
from midstride.model.action import Create
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.change_history import ChangeRecord
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, managed, replace
from tests.runtime.test_parameters import tuned

START = example("talker")


async def recorded(manager: Manager) -> list[ChangeRecord]:
    return (await manager.history(100)).changes


async def exchanged(manager: Manager, to: str = "NewTalker") -> Outcome:
    return await manager.change(replace("talker", to), by="anna: replace")


def test_a_change_is_recorded_with_what_its_report_says(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        outcome = await exchanged(manager)
        up, change = await recorded(manager)
        assert (up.command, up.by, up.outcome, up.version, up.missed) == ("up", None, "done", 1, None)
        assert [step.words for step in up.steps][:1] == ["create listener (Listener)"]
        assert (change.command, change.by) == ("replace talker with NewTalker", "anna: replace")
        assert (change.outcome, change.version) == ("done", 2)
        assert outcome.plan is not None and change.total == len(outcome.plan.steps) == len(change.steps)
        assert all(step.outcome == "done" and step.seconds is not None for step in change.steps)
        assert change.seconds == outcome.seconds and change.swaps == outcome.swaps
        [swap] = outcome.swaps
        assert (change.missed, change.gap) == (swap.missed, swap.gap) == (0, swap.gap)

    managed("talker", tmp_path, body)


def test_a_change_that_is_rolled_back_is_recorded_with_the_step_that_failed(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.fail_next("talker_2", "attach", "refused")
        outcome = await exchanged(manager)
        assert outcome.outcome == "rolled_back"
        _, change = await recorded(manager)
        assert (change.outcome, change.because, change.version) == ("rolled_back", outcome.because, 1)
        assert [step.outcome for step in change.steps] == ["done", "done", "failed"]

    managed("talker", tmp_path, body)


def test_a_change_that_is_refused_is_not_in_the_history(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        assert (await exchanged(manager, "Nonsense")).outcome == "refused"
        assert [change.command for change in await recorded(manager)] == ["up"]

    managed("talker", tmp_path, body)


def test_a_change_that_is_interrupted_by_the_end_of_the_manager_is_recorded_as_rolled_back(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.freeze("listener", 2.0)
        change = asyncio.ensure_future(exchanged(manager))
        while "talker_2" not in simulator.processes:
            await asyncio.sleep(0.01)
        change.cancel()
        await asyncio.gather(change, return_exceptions=True)
        _, found = await recorded(manager)
        assert (found.outcome, found.because) == ("rolled_back", "the manager was terminated")

    managed("talker", tmp_path, body)


def test_crashes_and_what_they_degrade_are_incidents(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("talker")
        await asyncio.sleep(1)
        found = [(each.kind, each.words) for each in (await manager.history(100)).incidents]
        assert [kind for kind, _ in found] == ["up", "exited", "degraded"]
        assert found[1][1].startswith("talker exited unexpectedly")
        assert found[2][1] == "degrade listener.listen from normal to degraded"

    managed("talker", tmp_path, body)


def test_an_earlier_specification_is_restored_by_an_ordinary_change(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await exchanged(manager)
        earlier = await manager.earlier_specification()
        assert (earlier.version, earlier.specification.specification()) == (1, START)
        outcome = await manager.change(PlanRequest(to=earlier.specification.specification()))
        assert (outcome.outcome, manager.specification) == ("done", START)
        [swap] = outcome.swaps
        assert (swap.missed, swap.duplicates) == (0, 0)
        assert [change.version for change in await recorded(manager)] == [1, 2, 1]
        assert (await manager.earlier_specification()).version == 2

    managed("talker", tmp_path, body)


def test_the_history_goes_on_after_down_and_the_next_up(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await exchanged(manager)
        await manager.down()
        await manager.close()
        again = Manager(START, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await again.up()
        assert [(change.command, change.version) for change in await recorded(again)] == [
            ("up", 1),
            ("replace talker with NewTalker", 2),
            ("up", 1),
        ]
        assert [each.kind for each in (await again.history(9)).incidents] == ["up", "down", "up"]
        assert (await again.earlier_specification()).version == 2
        await again.close()

    managed("talker", tmp_path, body)


def test_how_long_steps_took_is_the_estimate_of_the_next_plan(tmp_path: Path) -> None:
    simulator = Simulator(starting=0.7)

    async def body(manager: Manager, _: Simulator) -> None:
        def estimate(of: str) -> float:
            return next(
                step.seconds
                for step in plan.steps
                if isinstance(step.action, Create) and step.action.instance.component.name == of
            )

        plan = await manager.plan(replace("talker", "NewTalker"))
        assert estimate("NewTalker") == 1.0, "the default"
        await exchanged(manager)
        await exchanged(manager, "Talker")
        plan = await manager.plan(replace("talker", "NewTalker"))
        assert 0.7 < estimate("NewTalker") < 0.8
        assert plan.seconds == pytest.approx(sum(step.seconds for step in plan.steps))

    managed("talker", tmp_path, body, simulator)


# -- a journal that cannot be written ------------------------------------------------------------------


def refuse_writes(manager: Manager, refuse: bool) -> None:
    """As a full disk does; the state is in another file."""
    database = manager._journal._database
    assert database is not None
    [(pages,)] = database.read("PRAGMA page_count")
    database.connection.execute(f"PRAGMA max_page_count = {pages if refuse else 1_000_000}")


def test_on_a_full_disk_changes_are_refused_and_the_robot_goes_on(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        before = {name: process.pid for name, process in simulator.processes.items()}
        refuse_writes(manager, True)
        large = PlanRequest(replace=(("talker", "NewTalker"),), strategy="minimal")
        outcome = await manager.change(large, by="x" * 100_000)
        assert outcome.outcome == "refused"
        assert "journal.db: database or disk is full" in str(outcome.because)
        assert {name: process.pid for name, process in simulator.processes.items()} == before
        status = await manager.status()
        assert status.valid and "database or disk is full" in str(status.unwritten)
        refuse_writes(manager, False)
        assert (await exchanged(manager)).outcome == "done"
        assert (await manager.status()).unwritten is None

    managed("talker", tmp_path, body)


def test_a_damaged_journal_refuses_one_change_and_status_says_where_it_is_kept(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        before = sorted(simulator.processes)
        with closing(sqlite3.connect(tmp_path / "journal.db")) as other, other:
            other.execute("DROP TABLE changes")
        other.close()
        outcome = await exchanged(manager)
        aside = str(tmp_path / "journal.damaged.db")
        assert outcome.outcome == "refused" and aside in str(outcome.because)
        assert sorted(simulator.processes) == before
        status = await manager.status()
        assert status.valid and aside in str(status.damaged)
        assert (await exchanged(manager)).outcome == "done"
        assert [change.command for change in await recorded(manager)] == ["replace talker with NewTalker"]
        assert (await manager.history(9)).damaged == status.damaged

    managed("talker", tmp_path, body)


def test_a_damaged_journal_does_not_keep_the_next_manager_from_the_system(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await manager.close()
        (tmp_path / "journal.db").write_bytes(b"\xff" * 9000)
        again = Manager(START, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await again.up()
        status = await again.status()
        assert status.valid and "journal.damaged.db" in str(status.damaged) and status.unwritten is None
        assert any("journal.damaged.db" in event.words for event in again.log() if event.kind == "note")
        assert (await exchanged(again)).outcome == "done"
        await again.close()

    managed("talker", tmp_path, body)


def test_a_manager_that_another_one_has_superseded_begins_no_further_step(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        change = asyncio.ensure_future(exchanged(manager))
        while "talker_2" not in simulator.processes:
            await asyncio.sleep(0.01)
        other = Manager(START, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        taken = asyncio.ensure_future(other.up())
        with pytest.raises(ManagerError, match="another manager of this system has taken over"):
            raise ManagerError(str((await change).because))
        await taken
        with pytest.raises(ManagerError, match="has taken over"):
            raise ManagerError(str((await exchanged(manager)).because))
        assert (await other.status()).valid
        assert sorted(simulator.processes) == sorted(other.configuration.instances) == ["listener", "talker"]
        assert [each.outcome for each in await recorded(other)] == ["done", "rolled_back"]
        await other.close()

    managed("talker", tmp_path, body)


@pytest.mark.parametrize("declared", [False, True], ids=["kept", "--declared-parameters"])
def test_values_set_at_run_time_are_kept_by_a_rollback_unless_the_declared_ones_are_asked_for(
    declared: bool, tmp_path: Path
) -> None:
    (tmp_path / "workspace").mkdir()

    async def body(manager: Manager, _: Simulator) -> None:
        start = manager.specification
        await exchanged(manager)
        await manager.set_parameters("talker", {"label": "set at run time"})
        earlier = (await manager.earlier_specification()).specification.specification()
        assert earlier == start
        assert (await manager.change(PlanRequest(to=earlier, declared_parameters=declared))).outcome == "done"
        [talker] = [name for name, each in manager.configuration.instances.items() if each.role == "talker"]
        assert (await manager.peek(talker)).parameters["label"] == ("plain" if declared else "set at run time")

    managed("talker", tmp_path / "workspace", body, specification=tuned(tmp_path))
