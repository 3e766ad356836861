"""In which mode each functionality was, from the reports of its component."""

from __future__ import annotations

from typing import Any

from msgspec import structs

from midstride.runtime.records.mode_recorder import SAME_MODE, ModeInterval, ModeRecorder
from midstride.wire.state import ComponentState
from tests.runtime.scripted import TALKER, instance, reported, talking

CONFIGURATION = talking()


def state(name: str = "talker", mode: str = "normal", since: float = 0.0) -> ComponentState:
    """It has been in that mode for ``since`` seconds."""
    found = reported(CONFIGURATION.instances[name], CONFIGURATION, modes={"work": mode})
    views = {key: structs.replace(view, since=since) for key, view in found.functionalities.items()}
    return structs.replace(found, functionalities=views)


def recorder(**more: Any) -> ModeRecorder:
    return ModeRecorder(CONFIGURATION, more.get("created", []), lambda: 99.0)


def spans(intervals: list[ModeInterval]) -> list[tuple[str, str, float, float | None]]:
    return [(each.instance, each.mode, each.began, each.ended) for each in intervals]


def test_a_mode_is_one_interval_however_often_it_is_reported() -> None:
    found = recorder()
    for at, since in [(10.0, 5.0), (10.5, 5.5), (11.0, 6.0 - 0.9 * SAME_MODE)]:
        found.reported(state(since=since), at)
    assert spans(found.intervals(["talker"], 0.0, ["talker"])) == [("talker", "normal", 5.0, None)]


def test_a_mode_that_was_left_ends_when_the_next_one_begins() -> None:
    found = recorder()
    found.reported(state(since=5.0), 10.0)
    found.reported(state(mode="degraded", since=0.2), 12.0)
    found.reported(state(since=1.0), 15.0)  # left and entered again between two reports
    assert spans(found.intervals(["talker"], 0.0, ["talker"])) == [
        ("talker", "normal", 5.0, 11.8),
        ("talker", "degraded", 11.8, 14.0),
        ("talker", "normal", 14.0, None),
    ]
    assert len(found.intervals(["talker"], 13.0, ["talker"])) == 2, "those that lasted until then, and later ones"


def test_the_same_mode_entered_anew_is_another_interval() -> None:
    found = recorder()
    found.reported(state(since=5.0), 10.0)
    found.reported(state(since=0.0), 12.0)
    assert spans(found.intervals(["talker"], 0.0, ["talker"])) == [
        ("talker", "normal", 5.0, 12.0),
        ("talker", "normal", 12.0, None),
    ]


def test_what_is_gone_has_ended_and_other_roles_count_only_where_they_were_lowered() -> None:
    found = recorder(created=[instance("talker_2", TALKER, "talker")])
    found.reported(state(since=5.0), 10.0)
    found.reported(state("listener", since=5.0), 10.0)
    assert spans(found.intervals(["talker"], 0.0, ["listener"])) == [("talker", "normal", 5.0, 99.0)]
    found.reported(state("listener", mode="degraded", since=0.0), 12.0)
    listed = [each.instance for each in found.intervals(["talker"], 0.0, ["listener"])]
    assert listed == ["listener", "talker", "listener"]


def test_what_is_neither_there_nor_created_is_not_recorded() -> None:
    found = recorder()
    found.reported(structs.replace(state(), instance="stranger"), 10.0)
    assert found.intervals(["talker"], 0.0, []) == []
