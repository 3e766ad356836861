"""`use_sim_time`, set from outside while the system runs: the status shows it, and no hand-over crosses clocks."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Sequence
from dataclasses import replace as changed
from pathlib import Path

import pytest

from midstride.lang import load_text, render
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.records.measure import Observation, SwapReport
from midstride.runtime.records.reports import Event
from midstride.runtime.records.status_forms import Status
from midstride.runtime.watch import subscriber_recording
from midstride.runtime.watch.simulated_time import report_on_ros_clock
from midstride.wire.replies import ClockMoment, Receipt
from tests.acceptance.support import (
    PERIOD,
    ClockSource,
    Recorder,
    Starved,
    ended,
    managed,
    other_source,
    pids,
    sink_receives,
    swap_specification,
    when_the_cut_is_agreed,
)
from tests.backends.ros2_support import Bare, messages_are_numbered, publishers_are_told_apart, run, until_async
from tests.runtime.systems import replace

pytestmark = pytest.mark.ros2

# How late a slot may be although no process waits for a processor (s): `/clock` moves every 5 ms, and each of two
# publishers receives it in its own time.
CLOCK_LATE = 0.015
ON_CLOCK = "use_sim_time is on, and nothing has arrived on /clock yet: modes with a rate are not called"


@pytest.mark.full
def test_a_source_that_waits_for_a_clock_is_shown_and_not_handed_over(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            with Bare() as bare:
                await set_simulated_time(bare, "/source", True)
                assert not (await status_when(manager, ON_CLOCK)).valid
                declared = changed(replace("source", "OtherSource"), declared_parameters=True)
                outcome = await manager.change(declared)
                assert outcome.outcome == "rolled_back"
                assert "source follows /clock (use_sim_time) and source_2 the clock of the system" in str(
                    outcome.because
                )
                await set_simulated_time(bare, "/source", False)
                assert (await status_when(manager, None)).valid
                assert (await manager.change(replace("source", "OtherSource"))).outcome == "done"

    run(scenario())


@pytest.mark.full
def test_use_sim_time_set_while_it_runs_travels_to_the_replacement(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            clock = ClockSource(tmp_path, 1.0)
            with Bare() as bare:
                await set_simulated_time(bare, "/source", True)
                await status_when(manager, None)
                await sink_receives(manager, 50)
                outcome = await manager.change(replace("source", "OtherSource"))
                assert (outcome.outcome, outcome.because) == ("done", None)
                words = "source: use_sim_time = True, set at run time: kept"
                assert [value.words for value in outcome.parameters] == [words]
                state = await manager.peek("source_2")
                assert state.simulated_time and state.set_values() == {"use_sim_time": True}
                await set_simulated_time(bare, "/source", False)
                await sink_receives(manager, 50)
                outcome = await manager.change(other_source(manager))
                assert (outcome.outcome, outcome.parameters) == ("done", [])
            clock.stop()

    with ended():
        run(scenario())


@pytest.mark.full
@pytest.mark.parametrize("speed", [0.5, pytest.param(2.0, marks=pytest.mark.long)])
def test_nothing_is_missed_in_simulated_time_and_a_bare_recorder_agrees(
    speed: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the recorder received is judged on the clock as its source knows it, not as the components saw it."""
    seen: list[Observation] = []

    def kept(observation: Observation, moments: Sequence[ClockMoment], **options: bool) -> SwapReport:
        seen.append(observation)
        return report_on_ros_clock(observation, moments, **options)

    monkeypatch.setattr(subscriber_recording, "report_on_ros_clock", kept)

    async def scenario() -> tuple[list[SwapReport], list[Receipt]]:
        options = SystemOptions(use_sim_time=True)
        async with managed(tmp_path / "system", swap_specification(), options=options) as (manager, _):
            assert {row.waiting for row in (await manager.status()).instances} == {ON_CLOCK}
            clocks.append(ClockSource(tmp_path, speed))
            await status_when(manager, None)
            assert all(row.simulated_time for row in (await manager.status()).instances)
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)
            swaps = []
            for _ in range(3):
                starved, at_cut = Starved(clocks[0].pid, *pids(manager).values()), Starved()
                waits.append((starved, at_cut))

                def watch_both(starved: Starved = starved, at_cut: Starved = at_cut) -> None:
                    starved.watch(*pids(manager).values())
                    at_cut.watch(clocks[0].pid, *pids(manager).values())

                def look(event: Event, at_cut: Starved = at_cut) -> None:
                    if event.kind == "step_done" and event.step and event.step.action == "handover":
                        at_cut.look()

                when_the_cut_is_agreed(manager, watch_both)
                manager.events.listeners.append(look)
                async with starved.looked_at():
                    await sink_receives(manager, 40)  # the recorder has what comes before the first window, too
                    outcome = await manager.change(other_source(manager))
                manager.events.listeners.remove(look)
                assert (outcome.outcome, outcome.because, outcome.silences) == ("done", None, [])
                swaps.extend(outcome.swaps)
            return swaps, recorder.stop()

    clocks: list[ClockSource] = []
    # How long processes waited for a processor, around each change and at its cut.
    waits: list[tuple[Starved, Starved]] = []
    with ended():
        swaps, rows = run(scenario())
        moments = clocks[0].stop()
    assert len(swaps) == len(seen) == len(waits) == 3
    for swap, observed, (starved, at_cut) in zip(swaps, seen, waits, strict=True):
        begin = observed.begun - 20 * PERIOD / speed * 1e9
        inside = [row for row in rows if begin <= row.received <= observed.ended]
        outside = report_on_ros_clock(changed(observed, rows=inside), moments)
        if not publishers_are_told_apart():
            continue
        none_lost = 0 if messages_are_numbered() else None
        assert (swap.lost, outside.lost, outside.duplicates) == (none_lost, none_lost, 0)
        # A busy machine calls a publisher of 100 messages per second too late now and then, and brings `/clock` too
        # late to the subscriber, by which it tells slots apart; the recorder's slots are by the clock's own source. One
        # that gets no processor for the length of a slot is later by that.
        late = 0 if speed < 1 else 10 + starved.often(PERIOD / speed)
        assert swap.duplicates is not None and swap.duplicates <= late
        # A message at either end of the window may have reached one of the two within it.
        most = max(1, late)
        assert swap.missed is not None and outside.missed is not None and abs(swap.missed - outside.missed) <= most
        # On the steady clock, most would be missed at half the speed. Above real time, only the recorder can tell.
        assert speed > 1 or swap.missed <= starved.often(PERIOD / speed - CLOCK_LATE)
        assert not messages_are_numbered() or silence_at_the_cut(inside) <= PERIOD / speed + CLOCK_LATE + at_cut.seconds
    publishers = {row.publisher for row in rows}
    assert len(publishers) == 4 or None in publishers  # jazzy identifies none


def silence_at_the_cut(rows: Sequence[Receipt]) -> float:
    """From the last message of the old publisher to the first of the new one, whose number is 1 (s, of real time)."""
    written = sorted((row.source, row.number or 0) for row in rows if row.source is not None)
    first = max(index for index, (_, number) in enumerate(written) if number == 1)
    return (written[first][0] - written[first - 1][0]) / 1e9


@pytest.mark.full
def test_a_clock_that_stops_and_one_that_starts_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        options = SystemOptions(use_sim_time=True)
        async with managed(tmp_path / "system", swap_specification(), options=options) as (manager, _):
            clock = ClockSource(tmp_path, 1.0)
            await status_when(manager, None)
            await sink_receives(manager, 50)
            clock.drive(0.0)
            await until_async(lambda: is_still(manager))
            status = await manager.status()
            assert not status.valid and not status.silences
            outcome = await manager.change(other_source(manager))
            assert outcome.outcome == "rolled_back" and "/clock has not moved for" in str(outcome.because)
            clock.drive(1.0, at=5.0)  # a bag that is played again
            await sink_receives(manager, 50)
            assert (await manager.change(other_source(manager))).outcome == "done"
            await sink_receives(manager, 50)
            assert (await manager.status()).valid
            clock.stop()

    with ended():
        run(scenario())


@pytest.mark.full
def test_use_sim_time_set_while_it_runs_neither_silences_nor_bursts(tmp_path: Path) -> None:
    """At 50 Hz on either clock; /clock is of another epoch, and runs as fast as the system's."""

    async def scenario() -> tuple[list[Receipt], Starved]:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            clock = ClockSource(tmp_path, 1.0)
            starved = Starved(clock.pid, pids(manager)["source"])
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)
            with Bare() as bare:
                async with starved.looked_at():
                    for value in (True, False, True, False):
                        await set_simulated_time(bare, "/source", value)
                        await sink_receives(manager, 50)
            clock.stop()
            return recorder.stop(), starved

    with ended():
        rows, starved = run(scenario())
    times = sorted(row.source for row in rows if row.source is not None)
    gaps = [(later - earlier) / 1e9 for earlier, later in itertools.pairwise(times)]
    assert len(times) > 200
    # Each change of the clock may move the grid within its period, and costs at most one period more. So does a message
    # that is late by three quarters of a period because the source, or its clock, had to wait for a processor so long.
    assert max(gaps) < 10 * PERIOD + starved.longest
    assert sum(gap < PERIOD / 4 for gap in gaps) <= 4 + starved.often(0.75 * PERIOD)


async def is_still(manager: Manager) -> bool:
    return all(str(row.waiting).startswith("/clock has not moved for") for row in (await manager.status()).instances)


async def set_simulated_time(bare: Bare, node: str, value: bool) -> None:
    """As `ros2 param set` does."""
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

    client = bare.node.create_client(SetParameters, f"{node}/set_parameters")
    on = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    request = SetParameters.Request(parameters=[Parameter(name="use_sim_time", value=on)])
    assert (await bare.ask(client, request)).results[0].successful
    bare.node.destroy_client(client)


async def status_when(manager: Manager, waiting: str | None, instance: str = "source") -> Status:
    """The status, as soon as the instance reports that it waits for that."""
    while True:
        status = await manager.status()
        if {row.name: row.waiting for row in status.instances}[instance] == waiting:
            return status
        await asyncio.sleep(0.02)


RELAYS = """
system relays
contract Text = std_msgs/msg/String @ 20 Hz
component Source {
  run "python3 source.py"
  output out
  functionality talk { produces out  mode normal { guarantee out : Text }  mode off { } }
}
component Relay {
  run "python3 relay.py"
  input in : Text
  output out
  functionality answer { uses in  produces out  mode normal { assume in  guarantee out : Text }  mode off { } }
}
component OtherRelay like Relay { }
topic /numbers : Text
topic /answers : Text
node source : Source { out -> /numbers }
node relay : Relay { in <- /numbers  out -> /answers }
"""
SOURCE = """
import itertools
from midstride import Component
from std_msgs.msg import String

comp = Component("source")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
numbers = itertools.count()
talk.set_normal_mode(lambda: out.write(String(data=str(next(numbers)))), rate=20, outputs=[out])
talk.set_degraded_mode(lambda: None, name="off")
comp.start()
"""
RELAY = """
from midstride import Component
from std_msgs.msg import String

comp = Component("relay")
heard = comp.create_input("in", String, rate=20)
out = comp.create_output("out", String)
answer = comp.create_functionality("answer", inputs=[heard], outputs=[out])
answer.set_normal_mode(lambda message: out.write(message), inputs=[heard], outputs=[out], guarantees={out: 20.0})
answer.set_degraded_mode(lambda: None, name="off")
comp.start()
"""


@pytest.mark.full
def test_answers_to_messages_are_handed_over_in_simulated_time(tmp_path: Path) -> None:
    """The cut is on the clock of times of publication; a bare subscriber receives every number once."""
    from std_msgs.msg import String

    (tmp_path / "source.py").write_text(SOURCE)
    (tmp_path / "relay.py").write_text(RELAY)
    loaded = load_text(RELAYS, "relays.stride")
    assert loaded.specification is not None, render(loaded.diagnostics)
    specification = loaded.specification

    async def scenario() -> list[int]:
        options = SystemOptions(use_sim_time=True)
        async with managed(tmp_path / "system", specification, tmp_path, options) as (manager, _):
            clock = ClockSource(tmp_path, 0.5)
            with Bare() as bare:
                numbers: list[int] = []
                bare.node.create_subscription(String, "/answers", lambda text: numbers.append(int(text.data)), 100)
                await bare.until(lambda: len(numbers) > 20)
                await status_when(manager, None, "relay")  # which answers messages before it has heard of the clock
                for component in ("OtherRelay", "Relay"):
                    changing = asyncio.ensure_future(manager.change(replace("relay", component)))
                    await bare.until(changing.done, 60.0)
                    outcome = changing.result()
                    assert (outcome.outcome, outcome.because) == ("done", None)
                last = len(numbers)
                await bare.until(lambda: len(numbers) > last + 20)
                clock.stop()
                return numbers

    with ended():
        numbers = run(scenario())
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
