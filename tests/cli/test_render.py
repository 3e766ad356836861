"""What people are shown, from the documents that programs get."""

from __future__ import annotations

import io
from typing import Any

from rich.console import Console, RenderableType

from midstride.cli import render


def shown(rendered: RenderableType) -> list[str]:
    console = Console(file=io.StringIO(), width=200)
    console.print(rendered)
    assert isinstance(console.file, io.StringIO)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def plan(**changed: Any) -> dict[str, Any]:
    figures = {"disruption": 0.0, "proved_minimal": True, "seconds": 1.38, "makespan": 1.38, "strategy": "minimal"}
    return {"steps": [], "falls": [], "afterwards": [], **figures, **changed}


def done(outcome: str = "done", **changed: Any) -> dict[str, Any]:
    document = {"outcome": outcome, "plan": plan(), "seconds": 0.27, "fallen": {}, "swaps": [], "because": None}
    return {**document, **changed}


def test_a_plan_takes_as_long_as_its_steps_one_after_another() -> None:
    assert "takes about 1.38 s; strategy minimal." in render.cost(plan())
    assert "takes about 1.38 s (critical path 1.12 s); strategy paper." in render.cost(
        plan(makespan=1.12, strategy="paper")
    )


def test_what_stays_lower_is_reported() -> None:
    """`midstride remove` of what the brake relies on: it was meant to fall, and it has fallen."""
    lower = [{"functionality": "brake.watch", "from": "normal", "to": "cautious", "levels": 1}]
    assert shown(render.outcome(done())) == ["Done in 270 ms.", "Nothing fell below its level."]
    assert shown(render.outcome(done(plan=plan(afterwards=lower)))) == [
        "Done in 270 ms.",
        "Stays lower: brake.watch, from normal to cautious.",
    ]
    assert render.fallen_line(done(plan=plan(afterwards=lower))) == "brake.watch permanently"
    assert render.fallen_line(done(fallen={"brake.watch": 1.5, "talker.talk": 0.0})) == "brake.watch 1.50 s"
    assert render.fallen_line(done()) == "nothing"
    rolled_back = done("rolled_back", plan=plan(afterwards=lower), because="create filter_2 (Median): it ended")
    assert shown(render.outcome(rolled_back)) == [
        "Rolled back in 270 ms, every step undone: create filter_2 (Median): it ended",
        "Nothing fell below its level.",
    ]
    crashed = shown(render.outcome(done("rolled_back", because="the process of talker has ended", ended=["talker"])))
    assert crashed[1].startswith("Exited unexpectedly meanwhile: talker;")
    assert len(crashed) == 2


QUIET: dict[str, Any] = {"waiting": None, "ending": False}


def test_the_mode_of_an_unresponsive_component_is_unknown() -> None:
    row = {"name": "talker.talk", "mode": "normal", "normal": True, "because": None, "busy": None}
    component = {"name": "talker", "component": "Talker", "pid": 7, "reachable": True, "functionalities": [row]} | QUIET
    state = {
        "system": "talker",
        "backend": "sim",
        "valid": True,
        "components": [component],
        "topics": [],
        "silences": [],
    }
    live = shown(render.status({**state, "violations": []}))
    assert live[2].split() == ["talker", "Talker", "7", "talk", "normal"]
    silent = {**component, "reachable": False}
    lines = shown(render.status({**state, "valid": False, "violations": [], "components": [silent]}))
    assert " ".join(lines[2].split()) == "talker Talker 7, not responding talk unknown last known mode: normal"


def test_the_reason_for_a_mode_is_the_error_and_not_the_end_of_its_traceback() -> None:
    because = (
        'mode normal raised: ValueError: no map\n  File "slam.py", line 3, in normal\n    load(path)\n    ^^^^^^^^^^'
    )
    row = {"name": "slam.f", "mode": "off", "normal": False, "because": because, "busy": None}
    component = {"name": "slam", "component": "Slam", "pid": 5, "reachable": True, "functionalities": [row]} | QUIET
    document = {
        "system": "s",
        "backend": "sim",
        "valid": True,
        "components": [component],
        "topics": [],
        "violations": [],
        "silences": [],
    }
    text = "\n".join(shown(render.status(document)))
    assert "mode normal raised: ValueError: no map" in text
    assert "^^^" not in text


def test_silence_and_waiting_are_shown() -> None:
    row = {"name": "talker.talk", "mode": "normal", "normal": True, "because": None, "busy": None}
    component = {"name": "talker", "component": "Talker", "pid": 5, "reachable": True, "functionalities": [row]} | QUIET
    fault = {"kind": "not_receiving", "words": "sink.in receives nothing of what is published on /t", "seconds": 4.5}
    document = {"system": "s", "backend": "sim", "valid": False, "topics": [], "violations": [], "silences": [fault]}
    lines = shown(render.status({**document, "components": [{**component, "waiting": "no /clock"}]}))
    assert "waiting: no /clock" in lines[2]
    assert lines[-1] == "sink.in receives nothing of what is published on /t (for 4.50 s)"
    assert shown(render.outcome(done(silences=[{**fault, "seconds": None}])))[1:] == [fault["words"]]


def test_unexpected_degradation_is_reported() -> None:
    assert shown(render.outcome(done(degraded=["talker_2.talk"])))[1:] == [
        "Degraded unexpectedly meanwhile: talker_2.talk; see `midstride why talker_2.talk`."
    ]


def test_a_first_slot_that_was_late_is_in_the_report() -> None:
    assert shown(render.outcome(done(late={"counter_2": 0.25}))) == [
        "Done in 270 ms.",
        "Nothing fell below its level.",
        "The first slot of counter_2 was 250 ms late; its state moved before.",
    ]
