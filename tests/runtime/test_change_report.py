"""A change of the history, whole: what is recorded of it, and what is not known of older ones."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from msgspec import structs

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError
from midstride.model.configuration import Configuration, configure
from midstride.runtime.manager import Manager
from midstride.runtime.process.component_client import Disconnected
from midstride.runtime.records.mode_recorder import ModeRecorder
from midstride.wire.state import ComponentState, FunctionalityState
from tests.runtime.systems import example, managed, replace

TALKER = example("talker")


def test_a_change_is_recorded_with_its_plan_specifications_events_and_modes(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        outcome = await manager.change(replace("talker", "NewTalker"), by="anna: replace")
        found = await manager.change_report()
        assert outcome.plan is not None and found.plan is not None
        assert found.change.by == "anna: replace" and found.change.outcome == "done"
        assert found.plan.steps == outcome.plan.steps and found.plan.degradations == outcome.plan.degradations
        assert found.before is not None and found.after is not None
        assert found.before.nodes["talker"].component == "Talker"
        assert found.after.nodes["talker"].component == "NewTalker"
        assert found.outcome == structs.replace(outcome, plan=None)
        assert found.timeline is not None
        kinds = [event.kind for event in found.timeline.events]
        assert kinds[0] == "plan" and kinds[-1] == "outcome" and kinds.count("step_done") == len(outcome.steps)
        modes = [(each.instance, each.mode) for each in found.timeline.modes if each.role == "talker"]
        assert ("talker", "normal") in modes and modes[-1] == ("talker_2", "normal")
        [old] = [each for each in found.timeline.modes if each.instance == "talker"]
        assert old.ended is not None and found.timeline.since <= old.ended <= found.timeline.until
        up = await manager.change_report(1)
        assert up.change.command == "up" and up.plan is not None and len(up.plan.steps) == up.change.total
        with pytest.raises(ManagerError, match="the history has no change 9"):
            await manager.change_report(9)

    managed("talker", tmp_path, body)


def test_what_an_older_version_has_not_recorded_is_not_known(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await manager.change(replace("talker", "NewTalker"))
        with closing(sqlite3.connect(manager._workspace.journal)) as journal, journal:
            journal.execute("DELETE FROM records")
        found = await manager.change_report(2)
        assert (found.plan, found.outcome, found.timeline) == (None, None, None)
        assert found.change.outcome == "done" and found.after is not None

    managed("talker", tmp_path, body)


def test_the_record_of_another_version_is_refused_and_the_journal_kept(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await manager.change(replace("talker", "NewTalker"))
        with closing(sqlite3.connect(manager._workspace.journal)) as journal, journal:
            journal.execute("UPDATE records SET plan = '[]' WHERE change = 2")
        with pytest.raises(ManagerError, match="another version of Midstride has recorded change 2"):
            await manager.change_report(2)
        assert len((await manager.history(10)).changes) == 2 and (await manager.history(10)).damaged is None

    managed("talker", tmp_path, body)


# -- modes ---------------------------------------------------------------------------------------------


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def running() -> tuple[Configuration, ModeRecorder, Clock]:
    configuration = configure(TALKER.context, (TALKER.instance(role, role) for role in TALKER.nodes), ())
    clock = Clock()
    return configuration, ModeRecorder(configuration, [], clock), clock


def state(instance: str, mode: str, since: float, because: str = "", functionality: str = "listen") -> ComponentState:
    found = {functionality: FunctionalityState(mode=mode, since=since, because=because)}
    return ComponentState(
        instance=instance, uuid="u", pid=1, revision=1, functionalities=found, ports={}, parameters={}, stopping=1.0
    )


def test_what_ended_before_is_left_out() -> None:
    configuration, recorder, clock = running()
    recorder.reported(state("listener", "normal", 50.0), 100.0)
    clock.now = 120.0
    recorder.on_component_event(Disconnected("listener", exited=True))
    for since, ended in [(119.0, [120.0]), (120.0, [120.0]), (121.0, [])]:
        found = recorder.intervals({"listener"}, since, configuration.instances.keys())
        assert [each.ended for each in found] == ended, since


def test_a_mode_is_an_interval_from_when_it_was_entered() -> None:
    configuration, recorder, clock = running()
    recorder.reported(state("listener", "normal", 50.0), 100.0)
    clock.now = 101.0
    recorder.on_component_event(state("listener", "normal", 51.2))  # it has travelled for longer
    recorder.on_component_event(state("listener", "degraded", 0.25, "no input"))
    clock.now = 102.0
    recorder.on_component_event(state("listener", "normal", 0.5))
    found = recorder.intervals({"listener"}, 99.0, configuration.instances.keys())
    assert [(each.mode, each.began, each.ended, each.level, each.because) for each in found] == [
        ("normal", 50.0, 100.75, 0, None),
        ("degraded", 100.75, 101.5, 1, "no input"),
        ("normal", 101.5, None, 0, None),
    ]


def test_only_what_takes_part_or_was_lowered_is_kept() -> None:
    configuration, recorder, _ = running()
    recorder.reported(state("listener", "normal", 1.0), 100.0)
    recorder.reported(state("talker", "degraded", 1.0, "so", "talk"), 100.0)
    recorder.reported(state("a stranger", "degraded", 1.0), 100.0)
    names = configuration.instances.keys()
    assert [each.instance for each in recorder.intervals((), 100.0, names)] == ["talker"]
    assert [each.instance for each in recorder.intervals({"listener"}, 100.0, names)] == ["listener", "talker"]


def test_an_instance_that_has_gone_has_no_mode_any_more() -> None:
    _, recorder, clock = running()
    recorder.reported(state("listener", "normal", 1.0), 100.0)
    recorder.reported(state("talker", "normal", 1.0, functionality="talk"), 100.0)
    clock.now = 103.0
    recorder.on_component_event(Disconnected("listener"))
    clock.now = 104.0
    ends = {each.instance: each.ended for each in recorder.intervals({"listener", "talker"}, 100.0, {"listener"})}
    assert ends == {"listener": 103.0, "talker": 104.0}
