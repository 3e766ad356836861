"""What a component shows as ROS diagnostics: the entries of a state, and when they are published."""

from __future__ import annotations

from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from immutables import Map
from msgspec import structs

from midstride.backends.simulator.host import SimulatedHost
from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import Interval, Predicate
from midstride.node.diagnostic_status import DiagnosticEntry, Level, diagnostics
from midstride.wire.state import ComponentState, FieldSamples, FunctionalityState, LinkState, Measured

from .author import Bench, simulate
from .test_measured import started

DEPTH = Predicate("sensor_msgs/msg/Range", 10, fields=(("range", Interval(low=1.5)),))
ALERT = Predicate("std_msgs/msg/String", 20)
WATCHER = ComponentSpec.of(
    "watcher",
    inputs={"in": DEPTH, "spare": DEPTH},
    outputs=("out",),
    functionalities=(
        FunctionalitySpec(
            "watch",
            (
                Mode("normal", (InputAlternatives(("in",)), InputAlternatives(("in", "spare"))), Map({"out": ALERT})),
                Mode("degraded", (), Map()),
            ),
            ("in", "spare"),
            ("out",),
        ),
    ),
)
GOOD = Measured(window=1.0, covered=1.0, rate=20.0, age=0.02, jitter=0.001, longest=0.051)
SLOW = structs.replace(GOOD, rate=4.0, longest=0.25)
SILENT = Measured(window=1.0, covered=1.0, rate=0.0, age=3.0, longest=3.0)


def state(mode: str = "normal", waiting: str | None = None, **links: LinkState) -> ComponentState:
    """A watcher in ``mode``, with attachments to topics of their ports' names."""
    return ComponentState(
        instance="watcher_2",
        uuid="u",
        pid=1,
        revision=1,
        functionalities={"watch": FunctionalityState(mode=mode, since=1.0, because="nothing to see\nat all")},
        ports={port.rstrip("_"): {f"/{port.rstrip('_')}": link} for port, link in links.items()},
        parameters={},
        stopping=1.0,
        waiting=waiting,
    )


def shown(**arguments: Any) -> DiagnosticEntry:
    """The entry of the only attachment."""
    _, entry = diagnostics(state(**arguments), WATCHER)
    return entry


def received(measured: Measured | None, **fields: FieldSamples) -> LinkState:
    return LinkState(gate=None, count=100, measured=measured, fields=fields)


def written(measured: Measured, gate: Any = "open") -> LinkState:
    return LinkState(gate=gate, count=100, gated=3, measured=measured)


def test_a_component_in_its_normal_mode_is_ok_and_one_that_is_lowered_a_warning_with_the_reason() -> None:
    (entry,) = diagnostics(state(), WATCHER)
    assert entry == DiagnosticEntry(
        "component", Level.OK, "every functionality is in its normal mode", {"mode of watch": "normal"}
    )
    (entry,) = diagnostics(state(mode="degraded"), WATCHER)
    assert entry.level == Level.WARN
    assert entry.message == "watch is in mode degraded: nothing to see"


def test_a_mode_without_a_reason_is_shown() -> None:
    unsaid = state(mode="degraded")
    because = {"watch": structs.replace(unsaid.functionalities["watch"], because="")}
    (entry,) = diagnostics(structs.replace(unsaid, functionalities=because), WATCHER)
    assert entry.message == "watch is in mode degraded: "


def test_what_keeps_its_contract_is_ok() -> None:
    for links in ({"in_": received(GOOD)}, {"out": written(GOOD)}):
        entry = shown(**links)
        assert (entry.level, entry.message) == (Level.OK, "as declared")
    assert shown(in_=received(GOOD)).name == "in on /in"


@pytest.mark.parametrize("links", [{"in_": received(SLOW)}, {"out": written(SLOW)}])
def test_what_is_slower_than_declared_is_a_warning(links: Any) -> None:
    entry = shown(**links)
    assert entry.level == Level.WARN
    assert entry.message.startswith("4 Hz measured, ")


def test_silence_is_an_error_where_something_relies_on_it() -> None:
    entry = shown(in_=received(SILENT))
    assert (entry.level, entry.message) == (Level.ERROR, "no message for 3.0 s, 10 Hz declared")
    assert shown(out=written(SILENT)).level == Level.ERROR
    assert shown(spare=received(SILENT)).level == Level.WARN, "the other input suffices"
    assert shown(mode="degraded", in_=received(SILENT)).level == Level.WARN, "the degraded mode assumes nothing"
    assert shown(mode="degraded", out=written(SILENT)).level == Level.OK, "and guarantees nothing"
    assert shown(out=written(SILENT, gate="closed")).level == Level.OK


def test_of_two_alternatives_neither_is_relied_on_alone() -> None:
    normal = Mode("normal", (InputAlternatives(("spare", "in")),), Map({"out": ALERT}))
    functionality = changed(WATCHER.functionalities["watch"], modes=(normal, Mode("degraded", (), Map())))
    either = changed(WATCHER, functionalities=Map(watch=functionality))
    for heard in (state(in_=received(SILENT)), state(spare=received(SILENT))):
        _, entry = diagnostics(heard, either)
        assert entry.level == Level.WARN


def test_nothing_is_judged_before_a_whole_window_was_measured() -> None:
    assert shown(in_=received(structs.replace(SLOW, covered=0.9))).level == Level.OK
    assert shown(in_=received(None)).level == Level.OK


def test_a_field_outside_its_constraint_is_a_warning_while_that_lasts() -> None:
    wrong = FieldSamples(constraint=">= 1.5", checked=50, violations=7, run=2, last=0.5)
    entry = shown(in_=received(GOOD, range=wrong))
    assert (entry.level, entry.message) == (Level.WARN, "range is 0.5, declared range >= 1.5")
    assert entry.values["Violations of range"] == "7 of 50 checked"
    again = shown(in_=received(GOOD, range=structs.replace(wrong, run=0)))
    assert again.level == Level.OK
    assert again.values["Last violation of range"] == "0.5"


def test_the_values_are_declared_against_measured() -> None:
    assert shown(out=written(SLOW)).values == {
        "Declared frequency (Hz)": "20",
        "Actual frequency (Hz)": "4",
        "Duration of window (s)": "1",
        "Age of the last message (s)": "0.02",
        "Jitter (s)": "0.001",
        "Longest time between messages (s)": "0.25",
        "Events since attached": "100",
        "Gate": "open",
        "Events behind the closed gate": "3",
    }
    assert shown(mode="degraded", out=written(SILENT)).values["Declared frequency (Hz)"] == "none"


def test_a_component_that_waits_for_its_clock_is_stale() -> None:
    waiting = state(waiting="nothing has arrived on /clock", in_=received(SILENT))
    entries = diagnostics(structs.replace(waiting, simulated_time=True, clock_speed=0.0), WATCHER)
    assert {(entry.level, entry.message) for entry in entries} == {(Level.STALE, "nothing has arrived on /clock")}


def test_a_component_without_a_manager_is_a_warning() -> None:
    component, attachment = diagnostics(state(waiting="no manager has welcomed it yet", in_=received(GOOD)), WATCHER)
    assert (component.level, component.message) == (Level.WARN, "no manager has welcomed it yet")
    assert attachment.level == Level.OK


def entries(bench: Bench, instance: str) -> dict[str, DiagnosticEntry]:
    return {entry.name: entry for entry in bench.simulator.diagnostics(instance)}


def test_diagnostics_that_cannot_be_published_do_not_end_the_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(host: SimulatedHost, entries: Any) -> None:
        raise RuntimeError("no such topic")

    async def main(bench: Bench) -> None:
        monkeypatch.setattr(SimulatedHost, "publish_diagnostics", fails)
        await started(bench)
        before = bench.lab.reports
        await bench.sleep(5.0)
        assert bench.lab.reports - before >= 2 * 9
        said = [line for line in bench.simulator.log("talker").splitlines() if "/diagnostics" in line]
        assert len(said) == 1
        assert "RuntimeError: no such topic" in said[0]

    simulate(tmp_path, main)


def test_a_running_component_publishes_once_a_second_what_it_measures(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.mode("listener", "listen", "normal")
        await bench.sleep(3.0)
        assert entries(bench, "talker")["out on /depth"].message == "as declared"
        assert entries(bench, "listener")["in on /depth"].message == "as declared"
        await bench.send("talker", "set", parameters={"every": 5})
        await bench.sleep(3.0)
        assert entries(bench, "talker")["out on /depth"].message == "4 Hz measured, 20 Hz declared"
        assert entries(bench, "listener")["in on /depth"].level == Level.WARN
        await bench.send("talker", "set", parameters={"every": 1_000_000})
        await bench.sleep(3.0)
        assert entries(bench, "listener")["in on /depth"].level == Level.ERROR
        await bench.send("talker", "set", parameters={"every": 1})
        await bench.sleep(3.0)
        assert entries(bench, "listener")["in on /depth"].level == Level.OK

    simulate(tmp_path, main)
