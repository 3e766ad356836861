"""Changes while ``/clock`` drives the ROS clock: slower or faster than real time, standing still, starting again."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace as replace_fields
from pathlib import Path

import pytest
from msgspec import structs

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.virtual_clock import EPOCH
from midstride.runtime.manager import Manager
from midstride.runtime.records.measure import Observation, SwapReport, report
from midstride.runtime.records.reports import Outcome
from midstride.runtime.watch.simulated_time import LONGEST_STRETCH, on_ros_clock, report_on_ros_clock, stretch
from midstride.wire.replies import Receipt
from tests.runtime.scripted import instance, reported
from tests.runtime.systems import example, managed, replace

EXAMPLES = [("talker", "talker", "NewTalker"), ("filter", "filter", "MedianFilter")]
SECOND = 1_000_000_000


@pytest.mark.parametrize(("name", "role", "component"), EXAMPLES)
@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0, 10.0])
def test_a_replacement_in_simulated_time_misses_nothing_and_the_report_says_so(
    name: str, role: str, component: str, speed: float, tmp_path: Path
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        simulator.time.drive(speed, at=100 * SECOND)
        await asyncio.sleep(max(2.0, 2 / speed))
        return await manager.change(replace(role, component))

    outcome = managed(name, tmp_path, body)
    assert (outcome.outcome, outcome.because, outcome.below_baseline_seconds, outcome.silences) == (
        "done",
        None,
        {},
        [],
    )
    assert outcome.swaps
    for swap in outcome.swaps:
        assert (swap.missed, swap.lost, swap.duplicates) == (0, 0, 0)
        # State takes real time to move, which is more than one period of a fast clock.
        assert swap.gap is not None and swap.period is not None
        assert 0.8 * swap.period <= swap.gap <= 1.2 * swap.period + 0.02 * max(0.0, speed - 1)


def test_what_is_missed_in_simulated_time_is_counted(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        simulator.time.drive(0.5)
        await asyncio.sleep(4)
        return await manager.change(replace("talker", "NewTalker", "paper"))

    outcome = managed("talker", tmp_path, body, Simulator(starting=1.0))
    (swap,) = outcome.swaps
    assert outcome.outcome == "done"
    assert (swap.missed or 0) > 0 and (swap.gap_periods or 0) > 2


def test_a_clock_that_stands_still_refuses_a_hand_over_at_once_and_says_so(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        simulator.time.drive(1.0)
        await asyncio.sleep(1)
        simulator.time.drive(0.0)
        await asyncio.sleep(4)
        status = await manager.status()
        assert {row.waiting for row in status.instances} == {
            "/clock has not moved for 4 s: modes with a rate are not called"
        }
        assert not status.valid and not status.silences
        outcome = await manager.change(replace("talker", "NewTalker"))
        simulator.time.drive(1.0)
        await asyncio.sleep(1)
        assert (await manager.status()).valid
        assert (await manager.change(replace("talker", "NewTalker"))).outcome == "done"
        return outcome

    outcome = managed("talker", tmp_path, body)
    assert outcome.outcome == "rolled_back"
    assert "cannot hand over: /clock has not moved for" in str(outcome.because)
    assert outcome.seconds < 5


@pytest.mark.parametrize("when", [0.01, 0.1, 0.15, 0.2])
def test_a_clock_that_stops_during_a_hand_over_rolls_it_back_with_the_reason(when: float, tmp_path: Path) -> None:
    """Of a cut that has been agreed, T does not come: the old publisher goes on when the clock does."""

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        simulator.time.drive(1.0)
        await asyncio.sleep(1)
        changing = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        while "talker_2" not in simulator.processes:
            await asyncio.sleep(0.01)
        await asyncio.sleep(when)
        simulator.time.drive(0.0)
        outcome = await changing
        simulator.time.drive(1.0)
        await asyncio.sleep(2)
        status = await manager.status()
        assert status.valid and not status.silences
        return outcome

    outcome = managed("talker", tmp_path, body)
    assert outcome.outcome == "rolled_back"
    assert "/clock has not moved for" in str(outcome.because)
    assert outcome.seconds < 15


@pytest.mark.parametrize("when", [0.15, 0.25, 0.3, 0.35, 0.4])
def test_a_simulation_that_starts_again_during_a_hand_over_leaves_one_publisher(when: float, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.time.drive(1.0, at=100 * SECOND)
        await asyncio.sleep(1)
        changing = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        await asyncio.sleep(when)
        simulator.time.drive(1.0, at=SECOND)
        outcome = await changing
        for swap in outcome.swaps:  # slots before and after the jump cannot be told apart
            assert (swap.gap, swap.missed, swap.duplicates) == (None, None, None)
        await asyncio.sleep(1)
        counts = [await published(manager)]
        await asyncio.sleep(2)
        counts.append(await published(manager))
        assert counts[1] - counts[0] == pytest.approx(20, abs=1)
        assert (await manager.status()).valid

    managed("talker", tmp_path, body)


async def published(manager: Manager) -> int:
    """How many messages the listener has received."""
    (topics,) = (await manager.peek("listener")).ports.values()
    return topics["/chatter"].count


def test_an_output_that_falls_silent_in_simulated_time_is_found_and_a_slow_one_is_not(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.time.drive(0.05)
        await asyncio.sleep(30)
        assert (await manager.status()).silences == []

    managed("talker", tmp_path, body)


# -- the conversion alone --------------------------------------------------------------------------


def observation(speeds: list[float], period: float = 0.02) -> tuple[Observation, list[tuple[int, int]]]:
    """A publisher in each slot of a clock that runs 2 s at each speed, and is updated at 100 Hz of real time."""
    chance = random.Random(1)
    moments, rows, ros, due, number = [], [], 10 * SECOND, 10 * SECOND, 0
    for index in range(len(speeds) * 200):
        steady = index * SECOND // 100
        ros += round(speeds[index // 200] * SECOND / 100)
        moments.append((steady, ros))
        while due <= ros:  # at most once for each step of the clock is what rcl does; here every slot is served
            number += 1
            sent = steady + chance.randrange(500_000) + (due % 7)
            rows.append(Receipt(sent + 300_000 + chance.randrange(1_000_000), EPOCH + sent, number, "a"))
            due += round(period * SECOND)
    rows.sort(key=lambda row: row.received)
    end = moments[-1][0]
    return Observation("/t", "s.in", rows, end // 2, end, period, period), moments


@pytest.mark.parametrize("speeds", [[0.5, 0.5], [1.0, 0.0, 1.0], [0.2, 1.0, 0.5], [0.1, 0.0, 0.7, 0.3]])
def test_slots_are_found_again_on_a_clock_of_changing_speed(speeds: list[float]) -> None:
    seen, moments = observation(speeds)
    measured = report_on_ros_clock(seen, moments)
    assert measured.missed == 0
    assert (measured.gap or 0) < 3 * 0.02
    del seen.rows[len(seen.rows) * 3 // 4 : len(seen.rows) * 3 // 4 + 3]  # type: ignore[attr-defined]  # it is a list
    assert report_on_ros_clock(seen, moments).missed == 3


@pytest.mark.parametrize("speed", [0.3, 1.0, 4.0])
def test_times_of_publication_that_are_on_the_ros_clock_stay_there(speed: float) -> None:
    """As on ROS 1, where a publisher writes its own time: in steps, as `/clock` moves."""
    seen, moments = observation([speed, speed], period=0.1)
    on_clock = {row.number: on_ros_clock(seen, moments).rows[index].source for index, row in enumerate(seen.rows)}
    rows = [structs.replace(row, source=on_clock[row.number]) for row in seen.rows]
    measured = report_on_ros_clock(replace_fields(seen, rows=rows), moments, ros_sources=True)
    assert measured == report_on_ros_clock(seen, moments)
    assert measured.missed == 0


def test_on_the_wrong_clock_slots_seem_empty() -> None:
    """What the conversion is for."""
    seen, moments = observation([0.5, 0.5])
    assert (report(seen).missed or 0) > 30
    assert report_on_ros_clock(seen, moments).missed == 0


def test_a_message_whose_time_of_publication_is_unknown_is_measured_by_the_rest() -> None:
    seen, moments = observation([1.0, 1.0])
    rows = [row if number else structs.replace(row, source=None) for number, row in enumerate(seen.rows)]
    assert report_on_ros_clock(replace_fields(seen, rows=rows), moments).lost == 0


def test_two_moments_of_a_steady_clock_are_enough() -> None:
    seen, moments = observation([1.0, 1.0])
    assert report_on_ros_clock(seen, [moments[0], moments[-1]]).missed == 0


def test_a_clock_that_jumps_back_leaves_what_numbers_say() -> None:
    seen, moments = observation([1.0, 1.0, 1.0])
    jumped = [(steady, ros - 9 * SECOND if steady > 4 * SECOND else ros) for steady, ros in moments]
    measured = report_on_ros_clock(seen, jumped)
    assert measured == SwapReport("/t", "s.in", 0.02, None, None, None, 0, None)


def test_a_jump_back_before_the_change_does_not_matter() -> None:
    seen, moments = observation([1.0, 1.0, 1.0])
    jumped = [(steady, ros - 9 * SECOND if steady > SECOND else ros) for steady, ros in moments]
    assert report_on_ros_clock(seen, jumped).missed == 0


def test_time_outs_are_stretched_within_bounds() -> None:
    state = reported(instance("talker", example("talker").components["Talker"]))
    assert stretch(None) == stretch(state) == 1.0
    simulated = structs.replace(state, simulated_time=True)
    factors = [stretch(structs.replace(simulated, clock_speed=speed)) for speed in (0.0, 0.001, 0.5, 1.0, 10.0)]
    assert factors == [1.0, LONGEST_STRETCH, 2.0, 1.0, 1.0]
