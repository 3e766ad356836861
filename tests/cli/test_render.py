"""What people are shown, from the forms that the API has."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rich.console import Console, RenderableType

from midstride.cli import render, render_status
from midstride.cli.input_files import as_typed_here
from midstride.cli.output import PAGE_WIDTH, console
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.change.change_assessment import reported
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.status_forms import Middleware, Status
from midstride.verdicts import assessment
from tests.cli.statuses import component, crash, functionality, status


def shown(rendered: RenderableType) -> list[str]:
    console = Console(file=io.StringIO(), width=200)
    console.print(rendered)
    assert isinstance(console.file, io.StringIO)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def plan_document(**changed: Any) -> dict[str, Any]:
    figures = {"disruption": 0.0, "proved_minimal": True, "seconds": 1.38, "makespan": 1.38, "strategy": "minimal"}
    none = {"steps": [], "degraded": [], "degradations": [], "level_shifts": [], "lower_bound": 0.0}
    steps = [{"seconds": 0.1, **step} for step in changed.pop("steps", ())]
    return {**none, **figures, "steps": steps, **changed}


def plan(**changed: Any) -> PlanPreview:
    return msgspec.convert(plan_document(**changed), PlanPreview)


def done(outcome: str = "done", plan: dict[str, Any] | None = None, **changed: Any) -> Outcome:
    system = {"system": "s"}
    whole = {**(plan or plan_document()), "start": system, "target": system}
    made = msgspec.convert({"outcome": outcome, "plan": whole, "seconds": 0.27, **changed}, Outcome)
    return msgspec.structs.replace(made, continuity=assessment.assessed(reported(made, made.silences)))


HOLDS = {"verdict": "holds", "subject": "the plan", "scope": "s", "by": "Alloy"}


def swap(missed: int | None = 0, lost: int | None = 0, duplicates: int | None = 0) -> dict[str, Any]:
    counts = {"missed": missed, "lost": lost, "duplicates": duplicates}
    return {"topic": "/chatter", "subscriber": "listener.in", "period": 0.1, "gap": 0.1, "gap_periods": 1.0, **counts}


def lowered(**changed: Any) -> dict[str, Any]:
    brake = {"functionality": "brake.watch", "from": "normal", "to": "cautious", "planned": True, "because": None}
    return {**brake, **changed}


def test_a_plan_takes_as_long_as_its_steps_with_what_overlaps() -> None:
    assert "takes about 1.38 s; strategy minimal." in render.cost(plan())
    assert "takes about 1.12 s (1.38 s one step after another); strategy paper." in render.cost(
        plan(duration=1.12, strategy="paper")
    )


def test_a_plan_shows_the_spread_of_what_was_measured_where_it_is_wide() -> None:
    assert "takes about 1.38 s (1.10 s to 2.50 s); " in render.cost(plan(between=(1.1, 2.5)))
    assert "takes about 1.38 s; " in render.cost(plan(between=(1.36, 1.41)))
    assert "takes about 1.12 s (1.00 s to 2.50 s; 1.38 s one step after another); " in render.cost(
        plan(duration=1.12, between=(1.0, 2.5))
    )


def test_the_report_sets_what_was_measured_beside_the_plan() -> None:
    steps = [{"step": 1, "began": 0.0, "seconds": 1.0}, {"step": 2, "began": 1.0, "seconds": 0.5}]
    steps.append({"step": 3, "began": 1.0, "seconds": 0.25})
    assert shown(render.outcome(done(plan=plan_document(duration=1.12, between=(1.0, 1.6)), steps=steps)))[1] == (
        "Planned: 1.12 s (1.00 s to 1.60 s; 1.38 s one step after another). "
        "Measured: 1.50 s, for steps of 1.75 s in all."
    )
    assert shown(render.outcome(done(plan=plan_document(), steps=steps[:2])))[1] == "Planned: 1.38 s. Measured: 1.50 s."
    assert (
        len(
            shown(
                render.outcome(
                    done(
                        plan=plan_document(),
                        steps=steps,
                        verdict=HOLDS,
                    )
                )
            )
        )
        == 2
    )
    assert len(shown(render.outcome(done("rolled_back", plan=plan_document(), steps=steps)))) == 2


def test_how_far_apart_the_members_of_a_group_changed_their_modes_is_reported() -> None:
    skews = [{"kind": "degrade", "functionalities": ["a.work", "b.work"], "seconds": 0.00152}]
    assert shown(render.outcome(done(skews=skews)))[1] == "Degrade of a.work and b.work: within 1.5 ms."


def test_what_stays_lower_is_reported() -> None:
    """`midstride remove` of what the brake relies on: it was meant to fall, and it has fallen."""
    assert shown(render.outcome(done())) == ["Done in 270 ms.", "Nothing fell below its level."]
    in_part = render.outcome(done("incomplete", because="a is left out: no device"))
    assert shown(in_part)[0] == "In part, in 270 ms: a is left out: no device"
    assert shown(render.outcome(done(remaining_degradations=[lowered()]))) == [
        "Done in 270 ms.",
        "Afterwards: brake.watch is in mode cautious instead of normal.",
    ]
    assert render.fallen_line(done(remaining_degradations=[lowered()])) == "brake.watch permanently"
    assert (
        render.fallen_line(done(below_baseline_seconds={"brake.watch": 1.5, "talker.talk": 0.0}))
        == "brake.watch 1.50 s"
    )
    assert render.fallen_line(done()) == "nothing"
    lower = [{"functionality": "brake.watch", "from": "normal", "to": "cautious", "levels": 1}]
    rolled_back = done(
        "rolled_back", plan=plan_document(level_shifts=lower), because="create filter_2 (Median): it ended"
    )
    assert shown(render.outcome(rolled_back)) == [
        "Rolled back in 270 ms, every step undone: create filter_2 (Median): it ended",
        "Nothing fell below its level.",
    ]
    crashed = shown(
        render.outcome(done("rolled_back", because="the process of talker has ended", unexpected_exits=["talker"]))
    )
    assert crashed[1].startswith("Exited unexpectedly meanwhile: talker;")
    assert len(crashed) == 2


def test_a_plan_that_lowers_something_for_good_does_not_call_itself_free_of_disruption() -> None:
    lower = [{"functionality": "brake.watch", "from": "normal", "to": "cautious", "levels": 1}]
    afterwards = "brake.watch is in mode cautious instead of normal"
    lines = shown(
        render.plan(plan(steps=[{"action": "remove", "instance": "filter"}], level_shifts=lower), "remove filter")
    )
    assert lines[3] == f"Afterwards: {afterwards}."
    assert "Nothing degrades" not in "".join(lines)
    assert f"functionality-seconds on the way (proved minimal), and afterwards {afterwards};" in lines[4]


def test_what_a_plan_without_steps_remarks_is_said_too() -> None:
    words = "talker does not run, and this change does not start it: `midstride restart talker` restores it"
    lines = shown(render.plan(plan(steps=[], remarks=[words]), "apply robot.stride"))
    assert lines == ["apply robot.stride", "Nothing to do: the system already matches the target.", words]


@pytest.mark.parametrize(
    ("until", "unserved", "words"), [(1, None, "until step 1"), (None, 1, "throughout, unserved from step 1 on")]
)
def test_a_plan_does_not_claim_to_degrade_what_is_degraded_already(
    until: int | None, unserved: int | None, words: str
) -> None:
    """Such as `apply` after a crash: it restores, and each of its lines began with "Degrades"."""
    fall = {"functionality": "see.see", "from_step": 0, "to_step": until, "seconds": 0.053, "because": "already"}
    step = {"action": "upgrade", "modes": {"see_2.see": {"from": "off", "to": "normal"}}}
    better = [{"functionality": "see.see", "from": "off", "to": "normal", "levels": -1}]
    document = plan(steps=[step], degradations=[{**fall, "unserved_from_step": unserved}], level_shifts=better)
    lines = shown(render.plan(document, "apply robot.stride"))
    assert lines[3:5] == [
        f"Degraded already: see.see for about 53 ms more ({words})",
        "Improves: see.see, from off to normal",
    ]


def report(**changed: Any) -> list[str]:
    """What is said between the headline of an outcome and the table."""
    lines = shown(render.outcome(done(**changed)))[1:]
    return lines[: next(number for number, line in enumerate(lines) if line.startswith("topic "))]


NOTHING = "Nothing fell below its level."


@pytest.mark.parametrize("outcome", ["done", "rolled_back", "failed"])
def test_nothing_fell_is_not_said_above_missed_messages(outcome: str) -> None:
    assert report(outcome=outcome, swaps=[swap()]) == [NOTHING]
    missed = "Messages on /chatter at listener.in: 48 missed."
    assert report(outcome=outcome, swaps=[swap(missed=48), swap()]) == [missed]
    all_three = "Messages on /chatter at listener.in: 48 missed, 2 lost and 1 duplicate."
    assert report(outcome=outcome, swaps=[swap(48, 2, 1)]) == [all_three]
    lost = "Messages on /chatter at listener.in: 2 lost (missed and duplicates are not known)."
    assert report(outcome=outcome, swaps=[swap(None, 2, None)]) == [lost]
    assert report(outcome=outcome, swaps=[swap()], below_baseline_seconds={"a.b": 0.0}) == [
        "a.b was below its level for 0 ms."
    ]
    fell = "brake.watch was below its level for 500 ms."
    assert report(outcome=outcome, swaps=[swap(missed=48)], below_baseline_seconds={"brake.watch": 0.5}) == [
        fell,
        missed,
    ]


def test_nothing_fell_is_not_claimed_where_a_figure_is_unknown() -> None:
    said = "Nothing is known to have fallen below its level. Not measurable here: "
    said += "missed and duplicates at listener.in on /chatter."
    assert report(swaps=[swap(missed=None, duplicates=None)]) == [said]
    silence = {"kind": "not_answering", "instance": "listener", "words": "listener does not answer", "seconds": None}
    assert report(swaps=[swap(None, None, None)], silences=[silence]) == [
        "listener does not answer.",
        "Not measurable here: missed, lost and duplicates at listener.in on /chatter.",
    ]


def test_what_is_lower_unexpectedly_is_said_with_its_reason_on_one_line() -> None:
    because = 'mode normal raised: ValueError: no map\n  File "slam.py", line 3, in normal'
    raised = lowered(functionality="slam.f", to="off", planned=False, because=because)
    gone = lowered(to=None, planned=False, because="brake exited unexpectedly")
    assert report(remaining_degradations=[raised, gone], swaps=[swap()]) == [
        "Afterwards: slam.f is in mode off instead of normal: mode normal raised: ValueError: no map.",
        "Afterwards: no instance serves brake.watch: brake exited unexpectedly.",
    ]
    assert render.fallen_line(done(remaining_degradations=[raised])) == "slam.f permanently"


def test_the_mode_of_an_unresponsive_component_is_unknown() -> None:
    talker = component("talker", functionalities=[functionality("talk")])
    live = shown(render_status.status(status(talker)))
    assert live[2].split() == ["talker", "Talker", "7", "talk", "normal"]
    lines = shown(render_status.status(status({**talker, "reachable": False}, valid=False)))
    assert " ".join(lines[2].split()) == "talker Talker 7, not responding talk unknown last known mode: normal"


def test_each_host_has_a_line_and_its_nodes_are_unreachable_while_it_is() -> None:
    near = {"name": "base", "destination": "robot@base", "connected": True, "since": 0.0, "because": None}
    far = {**near, "name": "arm", "destination": "robot@arm", "connected": False, "because": "is it switched on?"}
    clock = {"clock_ahead": -0.0041, "clock_uncertainty": 0.0006}
    hosts = [{**near, **clock, "version": "1.2.3", "instances": []}, {**far, "version": "", "instances": ["a"]}]
    fault = {"kind": "unreachable", "instance": "a", "words": "a is unreachable, with host arm"}
    lost = component("a", host="arm", reachable=False, unreachable=True, functionalities=[functionality("x")])
    lines = shown(render_status.status(status(lost, component("b", host="base"), hosts=hosts, silences=[fault])))
    words = " ".join(" ".join(lines).split())
    assert "host base (robot@base): connected since" in words and "; no node" in words
    assert "its clock is -4.1 ± 0.6 ms from here" in words
    assert "host arm (robot@arm): unreachable since" in words
    assert "; nothing is known of a, and nothing is started elsewhere: is it switched on?" in words
    assert "7 on arm, unreachable" in words and "with host arm" not in words


def test_a_component_without_functionalities_has_a_line_too() -> None:
    assert shown(render_status.status(status(component("talker"))))[2].split() == ["talker", "Talker", "7", "none"]


def test_nodes_of_whose_code_the_same_is_not_known_share_a_line() -> None:
    rows = [("a", "no API"), ("b", "no API"), ("c", "too many files")]
    lines = shown(render_status.status(status(*(component(name, unknown_files=reason) for name, reason in rows))))
    assert lines[-2:] == [
        "a, b (each): whether its code has changed is not fully known: no API",
        "c: whether its code has changed is not fully known: too many files",
    ]


def test_a_file_below_the_current_folder_is_shown_as_it_is_typed_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert as_typed_here(str(tmp_path / "robots" / "a.stride")) == "robots/a.stride"
    assert as_typed_here(str(tmp_path.parent / "a.stride")) == str(tmp_path.parent / "a.stride")


@pytest.mark.parametrize(
    ("middleware", "where"),
    [
        (Middleware(name="rmw_x", domain="7", distribution="jazzy"), "rmw_x in domain 7 on ROS 2 jazzy"),
        (Middleware(name="rmw_x", domain="0"), "rmw_x in domain 0"),
        (
            Middleware(name="TCPROS", master="http://a:1", distribution="noetic"),
            "TCPROS at the master http://a:1 on ROS 1 noetic",
        ),
        (Middleware(name="TCPROS", master="http://a:1"), "TCPROS at the master http://a:1"),
        (
            Middleware(name="none: messages stay in the manager's process"),
            "none: messages stay in the manager's process",
        ),
    ],
)
def test_the_middleware_is_named_with_where_it_reaches(middleware: Middleware, where: str) -> None:
    shown_status = msgspec.structs.replace(status(), middleware=middleware)
    assert f"Middleware: {where}" in shown(render_status.platform(shown_status))


def test_after_a_crash_the_remedy_is_named() -> None:
    crashed = [crash("talker", remedy="`midstride restart talker` restores it"), crash("talker", None)]
    lines = shown(render_status.status(status(crashed=crashed, file="/r/robot.stride")))
    assert lines[:2] == ["s on sim: up, it has no nodes", "specification: /r/robot.stride"]
    assert lines[-2:] == [
        "talker exited unexpectedly (status -9); `midstride restart talker` restores it",
        "talker exited unexpectedly",
    ]


def test_the_reason_for_a_mode_is_the_error_and_not_the_end_of_its_traceback() -> None:
    because = (
        'mode normal raised: ValueError: no map\n  File "slam.py", line 3, in normal\n    load(path)\n    ^^^^^^^^^^'
    )
    row = functionality("f", "off", normal=False, because=because)
    text = "\n".join(shown(render_status.status(status(component("slam", functionalities=[row])))))
    assert "mode normal raised: ValueError: no map" in text
    assert "^^^" not in text


def test_silence_and_waiting_are_shown() -> None:
    fault = {"kind": "not_receiving", "instance": "sink", "seconds": 4.5}
    fault["words"] = "sink.in receives nothing of what is published on /t"
    waiting = component("talker", functionalities=[functionality("talk")], waiting="no /clock")
    lines = shown(render_status.status(status(waiting, valid=False, silences=[fault])))
    assert "waiting: no /clock" in lines[2]
    assert lines[-1] == "sink.in receives nothing of what is published on /t (for 4.50 s)"
    why = {"because": "input in is silent", "restoring": "restored when input in is back"}
    row = functionality("talk", "off", normal=False, **why)
    lines = shown(render_status.status(status(component("talker", functionalities=[row]))))
    assert "input in is silent; restored when input in is back" in lines[2]
    assert shown(render.outcome(done(silences=[{**fault, "seconds": None}])))[1:] == [f"{fault['words']}."]


def with_attachment(gate: str | None = None, fields: Any = (), **figures: Any) -> Status:
    """A status with one attachment, whose rate is declared as 50 Hz."""
    known = {"declared": 50.0, "rate": 50.0, "met": True, "window": 1.0, "age": 0.019, "jitter": 0.0004}
    attached = {"name": "out", "direction": "out", "functionalities": ["talk"], "topic": "/chatter", "type": None}
    port = {**attached, "gate": gate, **known, "longest": 0.021, "fields": list(fields), **figures}
    return status(component("talker", ports=[port]))


def test_what_is_measured_is_shown_where_it_differs_from_what_is_declared() -> None:
    assert len(shown(render_status.status(with_attachment()))) == 3
    slow: dict[str, Any] = {"rate": 9.87, "met": False}
    lines = shown(render_status.status(with_attachment(**slow)))
    assert lines[3:] == ["talker.out on /chatter: 9.87 Hz measured, 50 Hz declared (last message 19 ms ago)"]
    assert len(shown(render_status.status(with_attachment(gate="closed", **slow)))) == 3
    lines = shown(render_status.status(with_attachment(rate=0.0, met=False, age=None)))
    assert lines[3:] == ["talker.out on /chatter: 0 Hz measured, 50 Hz declared (no message yet)"]
    assert len(shown(render_status.status(with_attachment(rate=None, met=None, age=None)))) == 3


def test_a_field_is_shown_while_it_violates_its_constraint() -> None:
    field = {"field": "visibility", "constraint": ">= 1.5", "checked": 50, "violations": 7, "run": 2, "last": 0.5}
    lines = shown(render_status.status(with_attachment(fields=[field])))
    assert lines[3:] == ["talker.out on /chatter: visibility is 0.5, visibility >= 1.5 declared"]
    assert len(shown(render_status.status(with_attachment(fields=[{**field, "run": 0}])))) == 3
    (row,) = shown(render_status.measured(with_attachment(fields=[{**field, "run": 0}])))[2:]
    assert row.endswith("visibility >= 1.5: 7 of 50 violate it, last 0.5")


def test_every_attachment_is_in_the_table_of_what_is_measured() -> None:
    (row,) = shown(render_status.measured(with_attachment()))[2:]
    assert row.split() == "talker.out /chatter 50 Hz 50 Hz 1.00 s 19 ms 0 ms 21 ms –".split()


def test_unexpected_degradation_is_reported() -> None:
    assert shown(render.outcome(done(unexpected_degradations=["talker_2.talk"])))[1:] == [
        "Degraded unexpectedly meanwhile: talker_2.talk; see `midstride why talker_2.talk`."
    ]


def test_a_first_slot_that_was_late_is_in_the_report() -> None:
    assert shown(render.outcome(done(late={"counter_2": 0.25}))) == [
        "Done in 270 ms.",
        "Nothing fell below its level.",
        "The first slot of counter_2 was 250 ms late; its state moved before.",
    ]


def test_verbose_status_lists_the_topics_that_are_no_ports() -> None:
    talker = component("talker_2", run="talker", undeclared=["publishes on /debug (std_msgs/msg/String)"])
    lines = shown(render_status.platform(status(talker)))
    assert lines[-1].startswith("talker_2 publishes on /debug (std_msgs/msg/String): no port states that")


def test_nodes_outside_are_named_where_no_port_listens_or_publishes() -> None:
    topic: dict[str, Any] = {"name": "/cmd_vel", "topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "rate": 10.0}
    topic |= {"satisfied": True, "publishers": ["filter.out"], "subscribers": [], "outside": []}

    def line(**changed: Any) -> str:
        return shown(render_status.status(status(topics=[topic | changed])))[-1]

    assert line() == "/cmd_vel: filter.out → no subscriber"
    assert line(others={"publishers": [], "subscribers": []}) == "/cmd_vel: filter.out → no subscriber"
    outside = {"publishers": ["/teleop", "/joy"], "subscribers": ["/base"]}
    assert line(others=outside) == "/cmd_vel: filter.out → /base (not in the specification)"
    missing = line(others=outside, publishers=[], satisfied=False)
    assert missing.startswith("/cmd_vel: /teleop, /joy (not in the specification) → /base")


def test_tables_end_without_blanks_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    rows = render.table(["a", "b"])
    rows.add_row("1", "x" * 150)
    rows.add_row("2", "y")
    console().print(rows)
    assert capsys.readouterr().out.splitlines() == ["a  b", f"1  {'x' * 150}", "2  y"]
    console().print(rows, width=PAGE_WIDTH)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= PAGE_WIDTH


@pytest.mark.parametrize(
    ("type_", "words", "server", "client"),
    [
        ("nav_msgs/srv/GetMap", "service", "no server", "no client"),
        ("nav2_msgs/action/Dock", "ROS action", "no action server", "no action client"),
    ],
)
def test_a_service_is_shown_from_its_clients_to_its_server(type_: str, words: str, server: str, client: str) -> None:
    topic: dict[str, Any] = {"name": "/map", "topic": "/map", "type": type_, "rate": None}
    topic |= {"satisfied": True, "publishers": ["maps.map"], "subscribers": ["user.map", "dock.map"], "outside": []}

    def line(**changed: Any) -> str:
        return shown(render_status.status(status(topics=[topic | changed])))[-1]

    assert line() == f"{words} /map: user.map, dock.map → maps.map"
    assert line(subscribers=[]) == f"{words} /map: {client} → maps.map"
    assert line(publishers=[], satisfied=False) == f"{words} /map: user.map, dock.map → {server}  (not satisfied)"
