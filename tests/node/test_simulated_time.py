"""A cut while ``/clock`` drives the ROS clock: it stands still, starts again, or drives the one side only by messages.

There is no manager here: what the two sides do, they do alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.node.clock_history import KEPT, SPACING, STILL, ClockHistory
from tests.conformance import puppets
from tests.conformance.lab import Lab

from .test_handover import TOPIC, cut_at, in_lab, next_slot, outcomes, sides, stand_by

SECOND = 1_000_000_000


async def driven(lab: Lab, simulator: Simulator, speed: float = 1.0) -> None:
    simulator.time.drive(speed, at=100 * SECOND)
    await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))


async def gates(lab: Lab) -> list[str]:
    return [(await lab.port(side, "out", TOPIC))["gate"] for side in ("old", "new")]


async def heard(lab: Lab, seconds: float) -> list[str]:
    """Whose messages the sink receives in the next seconds."""
    before = len(await lab.received("sink"))
    await lab.sleep(seconds)
    return sides(await lab.received("sink"))[before:]


def test_a_simulation_that_starts_again_before_the_cut_ends_it_at_once(tmp_path: Path) -> None:
    """Else the old side would write until the new time reaches T, and then the new one, whatever has happened since."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await driven(lab, simulator)
        await cut_at(lab, await next_slot(lab, 0.2))
        simulator.time.drive(1.0, at=SECOND)
        assert set(await outcomes(lab, 0.2)) <= {"resumed", "cancelled"}
        assert await gates(lab) == ["open", "closed"]
        assert set(await heard(lab, 1.0)) == {"old"}

    in_lab(tmp_path, main)


def test_a_simulation_that_starts_again_before_the_new_side_has_written_has_the_old_one_resume(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await driven(lab, simulator)
        await cut_at(lab, await next_slot(lab, 0.2), resume_after=60.0)
        simulator.faults.freeze("new", 0.5)
        await lab.sleep(0.35)
        assert (await lab.port("old", "out", TOPIC))["gate"] == "closed", "it has passed T"
        simulator.time.drive(1.0, at=SECOND)
        await lab.sleep(0.5)
        assert set(await outcomes(lab, 0.2)) <= {"resumed", "cancelled"}
        assert await gates(lab) == ["open", "closed"]
        assert set(await heard(lab, 1.0)) == {"old"}

    in_lab(tmp_path, main)


def test_a_clock_that_goes_back_a_little_right_after_the_cut_leaves_one_writer(tmp_path: Path) -> None:
    """The old side learns that the new one has written when its own clock shows that T has not come."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await driven(lab, simulator)
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at)
        await lab.sleep((at - (await lab.read("old", "grid", port="out"))["now"]) / 1e9 - 0.02)
        simulator.faults.freeze("old", 0.05)
        await lab.sleep(0.04)
        simulator.time.drive(1.0, at=at - SECOND // 2)
        assert await outcomes(lab) == ("done", "done")
        assert await gates(lab) == ["closed", "open"]
        words = sides(await lab.received("sink"))
        assert set(words[words.index("new") :]) == {"new"}

    in_lab(tmp_path, main)


def test_while_the_clock_stands_still_nothing_is_due_and_the_new_side_is_not_late(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await driven(lab, simulator)
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at, resume_after=0.1)
        simulator.faults.freeze("new", 2.0)
        await lab.sleep((at - (await lab.read("old", "grid", port="out"))["now"]) / 1e9 + 0.01)
        simulator.time.drive(0.0)  # just after T, which the new side has not written
        await lab.sleep(3.0)
        simulator.time.drive(1.0)
        assert await outcomes(lab) == ("done", "done")
        assert set((await heard(lab, 1.0))[1:]) == {"new"}

    in_lab(tmp_path, main)


def test_on_a_fast_clock_the_new_side_has_real_time_to_be_late_in(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await driven(lab, simulator, speed=50.0)
        await cut_at(lab, await next_slot(lab, 5.0), resume_after=0.5)
        await lab.sleep(0.05)
        simulator.faults.freeze("new", 0.12)  # over the cut: 6 s on its clock
        assert await outcomes(lab) == ("done", "done")

    in_lab(tmp_path, main)


@pytest.mark.parametrize("speed", [0.2, 1.0, 10.0])
def test_a_cut_of_answers_is_agreed_on_the_clock_of_the_messages_they_answer(speed: float, tmp_path: Path) -> None:
    """Times of publication are the system's: on the ROS clock every message would seem newer than any cut."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        simulator.time.drive(speed, at=100 * SECOND)
        await lab.start("source", puppets.talker(rate=20 / speed))
        await lab.attach("source", "out", "/in")
        await lab.mode("source", "talk", "normal")
        await lab.start("sink", puppets.sink())
        await lab.attach("sink", "in", TOPIC)
        await lab.mode("sink", "hear", "normal")
        for name, gate in (("old", "open"), ("new", "closed")):
            await lab.start(name, puppets.relay())
            await lab.attach(name, "in", "/in", peers=1)
            await lab.attach(name, "out", TOPIC, peers=1, gate=gate)
            await lab.mode(name, "answer", "normal")
        await lab.sleep(0.5)
        grid: dict[str, Any] = await lab.read("old", "grid", port="out")
        assert (grid["trigger"], grid["clock"]) == ("message", "message")
        swaps = [{"port": "out", "topic": TOPIC}]
        at = grid["now"] + SECOND // 5
        await lab.change("old", "cut_out", cut="cut", swaps=swaps, at=at, resume_after=1.0, clock="message")
        await lab.change("new", "cut_in", cut="cut", swaps=swaps, at=at, peer="old", clock="message")
        assert await outcomes(lab) == ("done", "done")
        await lab.sleep(0.5)
        numbers = [int(words.rsplit(" ", 1)[-1]) for words in await lab.received("sink")]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), "each answered once, in order"

    in_lab(tmp_path, main)


# -- the history of a clock ------------------------------------------------------------------------


def run(history: ClockHistory, steady: int, ros: int, seconds: float, speed: float, step: int = SECOND // 100) -> int:
    """The clock runs on for so long; what it shows then."""
    for passed in range(step, round(seconds * SECOND) + 1, step):
        history.add(steady + passed, ros + round(passed * speed))
    return ros + round(seconds * SECOND * speed)


@pytest.mark.parametrize("speed", [0.05, 0.5, 1.0, 7.0])
def test_the_speed_is_that_of_the_last_second(speed: float) -> None:
    history = ClockHistory()
    assert history.speed(0) == 0.0
    ros = run(history, 0, SECOND, 5, 3.0)
    run(history, 5 * SECOND, ros, 2, speed)
    assert history.speed(7 * SECOND) == pytest.approx(speed, rel=0.02)
    assert history.speed(7 * SECOND + round(STILL * SECOND) + 1) == 0.0
    assert history.still_for(9 * SECOND) == 2.0


def test_after_a_jump_back_the_speed_is_that_since_the_jump() -> None:
    history = ClockHistory()
    run(history, 0, 100 * SECOND, 1, 1.0)
    run(history, SECOND, SECOND, 0.3, 0.5)
    assert history.speed(SECOND * 13 // 10) == pytest.approx(0.5)


def test_of_a_fast_clock_few_moments_are_kept_and_pauses_with_both_their_ends() -> None:
    history = ClockHistory()
    ros = run(history, 0, 0, 0.995, 1.0, step=SECOND // 1000)
    history.add(3 * SECOND, ros + 1)
    moments = history.moments()
    assert moments[-2:] == [(995_000_000, ros), (3 * SECOND, ros + 1)]
    assert len(moments) <= SECOND // SPACING + 3
    run(history, 3 * SECOND, ros, KEPT * SPACING / SECOND + 20, 1.0)
    assert len(history.moments()) <= KEPT + 1


def test_a_clock_that_repeats_its_time_stands_still() -> None:
    history = ClockHistory()
    run(history, 0, SECOND, 1, 1.0)
    for n in range(500):
        history.add(SECOND + n * SECOND // 100, 2 * SECOND)
    assert history.still_for(6 * SECOND) == 5.0 and history.speed(6 * SECOND) == 0.0
