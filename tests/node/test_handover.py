"""The agreed cut where one side is late, busy, failing or gone. What goes well is in the conformance checks."""

from __future__ import annotations

import itertools
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.network import SimulatedReader, SimulatedWriter
from midstride.errors import CommandRefused
from tests.conformance import puppets
from tests.conformance.lab import Lab
from tests.planting import plant

TOPIC = "/chatter"
SWAPS = [{"port": "out", "topic": TOPIC}]


def in_lab(folder: Path, main: Callable[[Lab, Simulator], Awaitable[None]]) -> None:
    simulator = Simulator()

    async def opened() -> None:
        async with Lab(simulator, folder) as lab:
            await main(lab, simulator)

    simulator.run(opened())


async def stand_by(lab: Lab, old: dict[str, Any], new: dict[str, Any], functionality: str = "talk") -> None:
    """``old`` on the topic, ``new`` behind its gate, both in their normal mode, and a sink that hears."""
    await lab.start("sink", puppets.sink())
    await lab.attach("sink", "in", TOPIC)
    await lab.mode("sink", "hear", "normal")
    for name, description, gate in (("old", old, "open"), ("new", new, "closed")):
        await lab.start(name, description)
        await lab.attach(name, "out", TOPIC, peers=1, gate=gate)
        await lab.mode(name, functionality, "normal")
    await lab.sleep(0.1)


async def next_slot(lab: Lab, least: float) -> int:
    """The first slot of the old one's grid that is at least so many seconds ahead."""
    grid = await lab.read("old", "grid", port="out")
    period = round(grid["period"] * 1e9)
    slots = (grid["now"] + round(least * 1e9) - grid["epoch"]) // period + 1
    return int(grid["epoch"] + slots * period)


async def cut_at(lab: Lab, at: int, resume_after: float = 1.0) -> None:
    await lab.change("old", "cut_out", cut="cut", swaps=SWAPS, at=at, resume_after=resume_after)
    await lab.change("new", "cut_in", cut="cut", swaps=SWAPS, at=at, epoch=at, peer="old")


async def outcomes(lab: Lab, timeout: float = 5.0) -> tuple[str, str]:
    """Of the old side, and of the new one."""
    told = [await lab.read(side, "await_cut", cut="cut", timeout=timeout) for side in ("old", "new")]
    return told[0]["outcome"], told[1]["outcome"]


def sides(words: list[str]) -> list[str]:
    return [word.split(" ")[0] for word in words]


def test_as_many_readers_as_before_are_not_the_same_readers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that has just come may be found before one that the old publisher has."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        begun = lab.backend.clock.steady()
        found = {"sink": 0.5, "recorder": 1.5, "new": 0.0}

        def ids(self: SimulatedWriter) -> frozenset[str]:
            return frozenset(name for name, after in found.items() if lab.backend.clock.steady() >= begun + after)

        plant(monkeypatch, SimulatedWriter, "reader_ids", ids)
        await lab.start("sink", puppets.sink())
        await lab.attach("sink", "in", TOPIC)
        await lab.start("node", puppets.talker())
        attach = {"port": "out", "topic": TOPIC, "gate": "closed"}
        request = {"port": "out", "topic": TOPIC, "peers": 1, "everyone": 1, "timeout": 10.0}
        await lab.change("node", "attach", **attach)
        attached = await lab.read("node", "await_readers", **request, reader_ids=["sink", "recorder"], patience=4.0)
        assert attached["matched"] == 1
        assert lab.backend.clock.steady() - begun >= 1.5
        await lab.change("node", "detach", port="out", topic=TOPIC)
        await lab.change("node", "attach", **attach)
        attached = await lab.read("node", "await_readers", **request, reader_ids=["sink", "dead"], patience=0.5)
        assert attached["matched"] == 0  # one of the two is missing
        with pytest.raises(CommandRefused, match="only 1 of 2 endpoints"):
            await lab.read("node", "await_readers", **{**request, "peers": 2, "timeout": 0.5}, patience=0.5)

    in_lab(tmp_path, main)


def test_a_publisher_is_found_by_its_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Others that are counted, and leave meanwhile, make no difference."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await lab.start("sink", puppets.sink())
        await lab.attach("sink", "in", TOPIC)
        for name in ("dead", "new"):
            await lab.start(name, puppets.talker())
            await lab.attach(name, "out", TOPIC, peers=1, gate="closed")
        new, dead = [each for name in ("new", "dead") for each in await simulator.publisher_ids(TOPIC, name)]
        assert await simulator.publisher_ids(TOPIC, "sink") == frozenset()
        request = {"port": "in", "topic": TOPIC, "peers": 3, "timeout": 0.5}
        begun = lab.backend.clock.steady()
        found = await lab.read("sink", "await_match", **request, publisher_ids=[new, dead])
        assert (found["matched"], found["missing"]) == (2, [])
        simulator.faults.kill("dead")
        found = await lab.read("sink", "await_match", **request, publisher_ids=[new])
        assert (found["matched"], found["missing"]) == (1, [])
        assert lab.backend.clock.steady() - begun < 0.1
        found = await lab.read("sink", "await_match", **request, publisher_ids=[new, dead])
        assert (found["matched"], found["missing"]) == (1, [dead])
        assert lab.backend.clock.steady() - begun >= 0.5

        def untold(self: SimulatedReader) -> None:
            return None

        plant(monkeypatch, SimulatedReader, "publisher_ids", untold)
        found = await lab.read("sink", "await_match", **request, publisher_ids=[new])
        assert (found["matched"], found["missing"]) == (1, None)

    in_lab(tmp_path, main)


def test_what_a_mode_with_a_rate_has_written_is_not_repeated_by_one_that_writes_nothing(tmp_path: Path) -> None:
    """Its old side has exited, and it has fallen to a mode that seems to have written once: the slot is not its."""

    async def main(lab: Lab, _: Simulator) -> None:
        await lab.start("sink", puppets.sink())
        await lab.attach("sink", "in", TOPIC)
        await lab.start("node", puppets.talker())
        await lab.attach("node", "out", TOPIC, peers=1, gate="closed")
        await lab.mode("node", "talk", "normal")
        await lab.sleep(0.5)
        assert (await lab.port("node", "out", TOPIC))["gated"] > 3
        await lab.mode("node", "talk", "degraded")
        await lab.change("node", "gate", port="out", topic=TOPIC, gate="open", latch=True)
        await lab.sleep(0.5)
        link = await lab.port("node", "out", TOPIC)
        assert (link["gate"], link["count"]) == ("open", 0)
        assert (await lab.exported("sink"))["received"] == {}

    in_lab(tmp_path, main)


@pytest.mark.parametrize(("mode", "seconds", "failed"), [({}, 0.2, False), ({"raise": "oh", "at_call": 2}, 0.1, True)])
def test_a_new_publisher_is_called_a_few_times_behind_its_gate_unless_it_fails(
    mode: dict[str, Any], seconds: float, failed: bool, tmp_path: Path
) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await lab.start("talker", puppets.talker(rate=10, mode=mode))
        await lab.attach("talker", "out", TOPIC, gate="closed")
        await lab.mode("talker", "talk", "normal")
        begun = simulator.clock.steady()
        wait = {"port": "out", "topic": TOPIC, "timeout": 5.0, "patience": 5.0}
        writes = await lab.read("talker", "await_write", calls=3, **wait)
        assert simulator.clock.steady() - begun == pytest.approx(seconds, abs=0.11)
        assert (writes["failed"], writes["gated"] >= 3) == (failed, not failed)

    in_lab(tmp_path, main)


def test_an_async_call_from_before_the_cut_still_writes(tmp_path: Path) -> None:
    """It writes 0.7 s after its slot; the cut comes in between. Its slot is the old one's, so it passes."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=2, mode={"pause": 0.7}), puppets.talker(rate=2))
        await lab.sleep(0.95)
        at = await next_slot(lab, 0.1)
        await cut_at(lab, at, resume_after=5.0)
        assert await outcomes(lab) == ("done", "done")
        told = await lab.read("old", "await_cut", cut="cut", timeout=1.0)
        last = told["last"][f"out {TOPIC}"]
        number, source = last["number"], last["source"]
        await lab.sleep(0.1)
        words = await lab.received("sink")
        assert source > at, "the test missed what it is about"
        assert number == sides(words).count("old") == (await lab.port("old", "out", TOPIC))["count"]

    in_lab(tmp_path, main)


def test_an_old_side_too_busy_to_hear_of_the_cut_is_never_cut(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=1, mode={"sleep": 0.9}), puppets.talker(rate=1))
        now = (await lab.read("old", "grid", port="out"))["now"]
        refused = await lab.refusal("old", "cut_out", cut="cut", swaps=SWAPS, at=now + 300_000_000, resume_after=1.0)
        assert "user code did not return within" in refused and "talk for" in refused, refused
        count = (await lab.port("old", "out", TOPIC))["count"]
        await lab.sleep(3.0)
        link = await lab.port("old", "out", TOPIC)
        assert link["gate"] == "open" and link["count"] >= count + 3 and link["gated"] == 0

    in_lab(tmp_path, main)


@pytest.mark.parametrize(("at_call", "held_back"), [(6, 0), (10, 0), (12, 1)])
def test_where_the_new_side_raises_before_it_writes_the_old_one_goes_on_at_once(
    at_call: int, held_back: int, tmp_path: Path
) -> None:
    """Before the moment of the cut, without missing a slot; at the moment itself, with the one that it left to it."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        raising = puppets.talker(rate=20, mode={"raise": "oh", "at_call": at_call})
        await stand_by(lab, puppets.talker(rate=20), raising)
        await cut_at(lab, await next_slot(lab, 0.4), resume_after=5.0)
        assert await outcomes(lab, timeout=2.0) == ("cancelled", "cancelled")
        await lab.sleep(0.2)
        assert set(sides(await lab.received("sink"))) == {"old"}
        assert (await lab.port("new", "out", TOPIC))["count"] == 0
        assert (await lab.port("old", "out", TOPIC))["gated"] <= held_back

    in_lab(tmp_path, main)


def test_a_new_side_that_has_failed_behind_its_gate_refuses_the_cut(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20, mode={"raise": "oh", "at_call": 2}))
        at = await next_slot(lab, 0.5)
        words = await lab.refusal("new", "cut_in", cut="cut", swaps=SWAPS, at=at, epoch=at, peer="old")
        assert "cannot take over: its functionality has failed" in words

    in_lab(tmp_path, main)


def test_an_old_side_that_hung_over_the_cut_is_not_heard_beside_the_new_one(tmp_path: Path) -> None:
    """Its call for the slot before the cut comes a second late; by then, the new side has long taken over."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at)
        await lab.sleep(0.1)
        simulator.faults.hang("old", 1.0)
        assert await outcomes(lab) == ("done", "done")
        await lab.sleep(0.2)
        heard = sides(await lab.received("sink"))
        assert heard == sorted(heard, reverse=True), "first the old side, then the new one"
        assert (await lab.port("old", "out", TOPIC))["gated"] >= 1

    in_lab(tmp_path, main)


def test_an_output_whose_code_has_raised_can_be_attached_with_an_open_gate(tmp_path: Path) -> None:
    """As the next manager does, which attaches before it upgrades; discovery takes a moment, and it waits for that."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await lab.start("sink", puppets.sink())
        await lab.attach("sink", "in", TOPIC)
        await lab.start("talker", puppets.talker(rate=20, mode={"raise": "oh"}))
        await lab.mode("talker", "talk", "normal")
        await lab.sleep(0.2)
        assert (await lab.functionality("talker", "talk"))["because"].startswith("mode normal raised")
        await lab.attach("talker", "out", TOPIC, peers=1)
        assert (await lab.port("talker", "out", TOPIC))["gate"] == "open"

    in_lab(tmp_path, main)


def test_where_the_new_side_dies_the_old_one_goes_on(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at, resume_after=0.5)
        simulator.faults.kill("new")
        told = await lab.read("old", "await_cut", cut="cut", timeout=5.0)
        assert told["outcome"] == "resumed"
        await lab.sleep(0.2)
        rows = [row[0] for row in await lab.rows("sink")]
        gaps = [later - earlier for earlier, later in itertools.pairwise(rows)]
        assert 0.5e9 <= max(gaps) <= 0.6e9, "silent for as long as was agreed, and no longer"

    in_lab(tmp_path, main)


def test_a_new_side_that_was_held_up_over_the_cut_writes_late_but_writes(tmp_path: Path) -> None:
    """Its call for the slot before the cut comes after it, and no other will come for the cut's own slot."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at)
        now = (await lab.read("old", "grid", port="out"))["now"]
        await lab.sleep((at - now) / 1e9 - 0.06)
        simulator.faults.freeze("new", 0.07)
        assert await outcomes(lab) == ("done", "done")
        await lab.sleep(0.3)
        rows = [row[0] for row in await lab.rows("sink")]
        gaps = [later - earlier for earlier, later in itertools.pairwise(rows)]
        assert 0.055e9 <= max(gaps) <= 0.065e9, "as late as it was held up, and not a slot more"

    in_lab(tmp_path, main)


def test_where_the_old_side_dies_at_the_cut_the_new_one_writes(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at)
        await lab.sleep(0.15)
        simulator.faults.kill("old")
        told = await lab.read("new", "await_cut", cut="cut", timeout=20.0)
        assert told["outcome"] == "done" and told["first"][f"out {TOPIC}"]["number"] == 1
        await lab.sleep(0.2)
        assert (await lab.port("new", "out", TOPIC))["gate"] == "open"
        assert sides(await lab.received("sink"))[-1] == "new"

    in_lab(tmp_path, main)


def test_a_frozen_old_side_learns_late_and_does_not_take_up_again(tmp_path: Path) -> None:
    """Frozen over the cut and longer than it would wait: `taken` is there before its patience ends."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        at = await next_slot(lab, 0.2)
        await cut_at(lab, at, resume_after=0.5)
        simulator.faults.freeze("old", 1.0)
        await lab.sleep(2.0)
        assert await outcomes(lab) == ("done", "done")
        words = sides(await lab.received("sink"))
        first_new = words.index("new")
        late = words[first_new:].count("old")
        assert late <= 1, "at most the call of a slot before the cut, which it was in when it froze"

    in_lab(tmp_path, main)


def test_where_every_report_is_lost_the_old_side_does_not_write_again(tmp_path: Path) -> None:
    """It waits for as long as it would wait for a new side that has died; then it sees that this one has not."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        simulator.faults.fail_next("old", "taken", "lost_request", 1000)
        await cut_at(lab, await next_slot(lab, 0.2), resume_after=0.5)
        assert await outcomes(lab, timeout=20.0) == ("done", "done")
        await lab.sleep(1.0)
        words = sides(await lab.received("sink"))
        assert words == sorted(words, reverse=True) and {"old", "new"} == set(words)

    in_lab(tmp_path, main)


def test_a_new_side_does_not_ask_another_process_that_has_the_name_of_the_old_one(tmp_path: Path) -> None:
    """Its report has not been answered yet when the old one ends, and the next instance is given the name."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        simulator.faults.fail_next("old", "taken", "lost_reply", 1000)
        await cut_at(lab, await next_slot(lab, 0.2))
        await lab.sleep(0.5)
        simulator.faults.kill("old")
        await lab.exited("old")
        simulator.faults.clear()
        lab.exits.clear()
        lab.registrations.clear()
        await lab.start("old", puppets.talker(rate=20))
        told = await lab.read("new", "await_cut", cut="cut", timeout=20.0)
        assert told["outcome"] == "done"
        assert (await lab.port("new", "out", TOPIC))["gate"] == "open"
        before = len(await lab.received("sink"))
        await lab.sleep(1.0)
        assert len(await lab.received("sink")) >= before + 19

    in_lab(tmp_path, main)


def test_a_new_side_that_was_stopped_over_the_cut_writes_nothing_once_the_old_one_does(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        simulator.faults.fail_next("old", "taken", "lost_request", 1000)
        await cut_at(lab, await next_slot(lab, 0.2), resume_after=0.5)
        simulator.faults.freeze("new", 1.5)
        assert await outcomes(lab) == ("resumed", "cancelled")
        await lab.sleep(1.0)
        assert set(sides(await lab.received("sink"))) == {"old"}

    in_lab(tmp_path, main)


async def reopened(lab: Lab) -> bool:
    return bool((await lab.port("old", "out", TOPIC))["gate"] == "open")


@pytest.mark.parametrize("reports", ["arrive", "are lost"])
@pytest.mark.parametrize("asked", [True, False])
@pytest.mark.parametrize("how", ["is killed", "is detached", "is cancelled", "is settled"])
def test_an_old_side_that_has_done_its_part_writes_again_when_the_new_one_cannot(
    how: str, asked: bool, reports: str, tmp_path: Path
) -> None:
    """As where the manager cannot reach the new side and then kills it, or cannot reach the old one, or dies."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        if reports == "are lost":
            simulator.faults.fail_next("old", "taken", "lost_request", 1000)
        await cut_at(lab, await next_slot(lab, 0.2))
        assert await outcomes(lab, timeout=20.0) == ("done", "done")
        if asked:
            assert "can still write" in await lab.refusal("old", "cancel_cut", cut="cut")
        await lab.sleep(1.0)
        assert not await reopened(lab)
        if how == "is killed":
            simulator.faults.kill("new")
        elif how == "is detached":
            await lab.change("new", "detach", port="out", topic=TOPIC)
        else:
            await lab.change("new", "cancel_cut", cut="cut")
        if how == "is settled":  # by the next manager, which goes by what is then open
            await lab.read("old", "resolve_cuts", new=False)
            assert await reopened(lab)
        await lab.eventually("the old side writes again", lambda: reopened(lab))
        await lab.sleep(0.2)
        words = sides(await lab.received("sink"))
        assert [word for word, _ in itertools.groupby(words)] == ["old", "new", "old"]

    in_lab(tmp_path, main)


@pytest.mark.parametrize("how", ["is cancelled", "is detached"])
def test_an_old_side_leaves_the_gate_to_a_later_cut(how: str, tmp_path: Path) -> None:
    """Its successor ends, and has handed over the topic before."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        await cut_at(lab, await next_slot(lab, 0.2))
        assert await outcomes(lab) == ("done", "done")
        await lab.start("newest", puppets.talker(rate=20))
        await lab.attach("newest", "out", TOPIC, peers=1, gate="closed")
        await lab.mode("newest", "talk", "normal")
        at = await next_slot(lab, 0.2)
        await lab.change("new", "cut_out", cut="second", swaps=SWAPS, at=at, resume_after=1.0)
        await lab.change("newest", "cut_in", cut="second", swaps=SWAPS, at=at, epoch=at, peer="new")
        if how == "is cancelled":
            await lab.change("new", "cancel_cut", cut="cut")
        else:
            await lab.read("newest", "await_cut", cut="second", timeout=5.0)
            await lab.read("new", "await_cut", cut="second", timeout=5.0)
            await lab.change("new", "detach", port="out", topic=TOPIC)
        await lab.sleep(1.0)
        assert not await reopened(lab), "the new one writes, by its later cut, or the newest one does"
        words = sides(await lab.received("sink"))
        assert [word for word, _ in itertools.groupby(words)] == ["old", "new", "newest"]

    in_lab(tmp_path, main)


def test_an_attach_that_finds_too_few_says_how_many(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await lab.start("sink", puppets.sink())
        await lab.attach("sink", "in", TOPIC)
        await lab.start("node", puppets.talker())
        with pytest.raises(CommandRefused, match="only 1 of 2 endpoints"):
            await lab.change("node", "attach", port="out", topic=TOPIC, peers=2, timeout=0.5)

    in_lab(tmp_path, main)


def test_a_late_duplicate_of_taken_changes_nothing(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        await cut_at(lab, await next_slot(lab, 0.2))
        assert await outcomes(lab) == ("done", "done")
        assert await lab.read("old", "taken", cut="cut") == {"resumed": False}
        await lab.change("new", "cancel_cut", cut="cut")
        await lab.change("old", "cancel_cut", cut="cut")
        assert await lab.read("old", "taken", cut="cut") == {"resumed": True}
        assert await lab.read("old", "taken", cut="unheard of") == {"resumed": True}
        foreign = await lab.send("old", "taken", {"cut": "cut"}, id="y", token="another's")
        assert foreign.refused is not None

    in_lab(tmp_path, main)


def test_questions_on_their_way_at_the_cut_are_answered_once(tmp_path: Path) -> None:
    """A question takes 80 ms to arrive, longer than the grace; whose it is goes by its source time."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await lab.start("source", puppets.talker(rate=100))
        await stand_by(lab, puppets.relay(), puppets.relay(), "answer")
        for name in ("old", "new"):
            await lab.attach(name, "in", "/questions")
        await lab.attach("source", "out", "/questions", peers=2)
        simulator.faults.delay("/questions", 0.08)
        await lab.mode("source", "talk", "normal")
        await lab.sleep(0.5)
        now = (await lab.read("old", "grid", port="out"))["now"]
        await lab.change("old", "cut_out", cut="cut", swaps=SWAPS, at=now + 123_456_789, resume_after=1.0)
        await lab.change("new", "cut_in", cut="cut", swaps=SWAPS, at=now + 123_456_789, epoch=None, peer="old")
        assert await outcomes(lab) == ("done", "done")
        await lab.mode("source", "talk", "degraded")
        await lab.sleep(0.5)
        asked = (await lab.exported("source"))["calls"]["talk.normal"]
        assert await lab.received("sink") == [f"source normal {n}" for n in range(1, asked + 1)]
        assert (await lab.port("new", "out", TOPIC))["count"] > 5

    in_lab(tmp_path, main)


def test_a_newer_question_on_one_way_does_not_shut_the_door_on_older_ones_on_another(tmp_path: Path) -> None:
    """The old side has seen a question from after the cut while some from before it are still on a slower way."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        sources = {"fast": "/fast", "slow": "/slow"}
        for name in sources:
            await lab.start(name, puppets.talker(rate=100))
        await stand_by(lab, puppets.relay(), puppets.relay(), "answer")
        for name, topic in sources.items():
            for side in ("old", "new"):
                await lab.attach(side, "in", topic)
            await lab.attach(name, "out", topic, peers=2)
        simulator.faults.delay("/slow", 0.04)
        for name in sources:
            await lab.mode(name, "talk", "normal")
        await lab.sleep(0.5)
        now = (await lab.read("old", "grid", port="out"))["now"]
        await lab.change("old", "cut_out", cut="cut", swaps=SWAPS, at=now + 123_456_789, resume_after=1.0)
        await lab.change("new", "cut_in", cut="cut", swaps=SWAPS, at=now + 123_456_789, epoch=None, peer="old")
        assert await outcomes(lab) == ("done", "done")
        for name in sources:
            await lab.mode(name, "talk", "degraded")
        await lab.sleep(0.5)
        heard = await lab.received("sink")
        for name in sources:
            asked = (await lab.exported(name))["calls"]["talk.normal"]
            own = [words for words in heard if words.startswith(name)]
            assert own == [f"{name} normal {n}" for n in range(1, asked + 1)]

    in_lab(tmp_path, main)


def test_one_cut_takes_several_outputs(tmp_path: Path) -> None:
    def two_outputs() -> dict[str, Any]:
        description = puppets.talker(rate=20)
        description["component"]["outputs"].append("log")
        talk = description["component"]["functionalities"]["talk"]
        talk["produces"].append("log")
        talk["modes"]["normal"]["guarantees"]["log"] = {"type": puppets.STRING, "rate": 20}
        return description

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, two_outputs(), two_outputs())
        for name, gate in (("old", "open"), ("new", "closed")):
            await lab.attach(name, "log", "/log", gate=gate)
        at = await next_slot(lab, 0.2)
        swaps = [*SWAPS, {"port": "log", "topic": "/log"}]
        await lab.change("old", "cut_out", cut="cut", swaps=swaps, at=at, resume_after=1.0)
        await lab.change("new", "cut_in", cut="cut", swaps=swaps, at=at, epoch=at, peer="old")
        assert await outcomes(lab) == ("done", "done")
        told = (await lab.read("old", "await_cut", cut="cut", timeout=1.0))["last"]
        assert set(told) == {f"out {TOPIC}", "log /log"}
        for port, topic in (("out", TOPIC), ("log", "/log")):
            assert (await lab.port("old", port, topic))["gate"] == "closed"
            assert (await lab.port("new", port, topic))["gate"] == "open"
            assert (await lab.port("new", port, topic))["count"] >= 1

    in_lab(tmp_path, main)


def test_a_detach_that_user_code_holds_up_leaves_the_gate_as_it_was(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=0.5, mode={"sleep": 1.5}), puppets.talker(rate=20))
        refused = await lab.refusal("old", "detach", port="out", topic=TOPIC, timeout=0.2)
        assert "user code did not return" in refused
        await lab.sleep(3.0)
        link = await lab.port("old", "out", TOPIC)
        assert link["gate"] == "open" and link["gated"] == 0 and link["count"] >= 1

    in_lab(tmp_path, main)


def test_a_detach_that_user_code_holds_up_half_way_opens_the_gate_again(tmp_path: Path) -> None:
    """A call begins while acknowledgements are awaited: the gate is closed by then, and the endpoint cannot go."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=0.4, mode={"sleep": 1.5}), puppets.talker(rate=20))
        await lab.eventually("its first call ends", lambda: _idle(lab))
        simulator.faults.delay(TOPIC, 3.0)
        await lab.eventually("it is called again", lambda: _busy(lab))
        await lab.eventually("it has written again", lambda: _idle(lab))
        reply = await lab.reply("old", "detach", True, port="out", topic=TOPIC, timeout=1.1)
        assert reply.refused is not None and "user code did not return" in reply.refused
        assert await _busy(lab), "the test missed what it is about"
        await lab.sleep(1.0)
        before = await lab.port("old", "out", TOPIC)
        await lab.sleep(5.0)
        after = await lab.port("old", "out", TOPIC)
        assert before["gate"] == after["gate"] == "open" and after["count"] >= before["count"] + 2

    in_lab(tmp_path, main)


async def _busy(lab: Lab) -> bool:
    return (await lab.functionality("old", "talk"))["busy"] is not None


async def _idle(lab: Lab) -> bool:
    return not await _busy(lab)


def test_a_detach_waits_until_every_reader_has_acknowledged_as_far_as_its_time_goes(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        simulator.faults.delay(TOPIC, 0.5)
        await lab.sleep(0.2)
        begun = lab.clock.steady()
        detached = await lab.change("old", "detach", port="out", topic=TOPIC, timeout=2.0)
        assert detached["acknowledged"] is True and 0.4 < lab.clock.steady() - begun < 0.6
        await lab.change("new", "gate", port="out", topic=TOPIC, gate="open")
        await lab.sleep(0.2)
        begun = lab.clock.steady()
        detached = await lab.change("new", "detach", port="out", topic=TOPIC, timeout=0.2)
        assert detached["acknowledged"] is None and 0.15 < lab.clock.steady() - begun < 0.25
        await lab.sleep(1.0)
        assert len(await lab.received("sink")) == len(await lab.rows("sink"))

    in_lab(tmp_path, main)


def test_during_a_cut_the_gates_are_the_cuts(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        await cut_at(lab, await next_slot(lab, 0.5))
        for side, gate in (("old", "closed"), ("new", "open")):
            refused = await lab.refusal(side, "gate", port="out", topic=TOPIC, gate=gate)
            assert f"out {TOPIC} is part of a cut under way; cancel the cut first" in refused
        assert await outcomes(lab) == ("done", "done")
        await lab.sleep(0.1)
        words = sides(await lab.received("sink"))
        assert words == sorted(words, reverse=True) and {"old", "new"} == set(words)
        await lab.change("new", "gate", port="out", topic=TOPIC, gate="closed")

    in_lab(tmp_path, main)


def test_a_cut_that_resumes_late_leaves_the_next_cut_alone(tmp_path: Path) -> None:
    """The gate was opened by a command meanwhile, and a second hand-over agreed."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        first = await next_slot(lab, 0.1)
        await lab.change("old", "cut_out", cut="first", swaps=SWAPS, at=first, resume_after=1.0)
        await lab.sleep(0.3)
        await lab.change("old", "gate", port="out", topic=TOPIC, gate="open")
        await lab.sleep(0.6)
        at = await next_slot(lab, 0.3)
        assert at > first + 10**9, "the first one resumes before the second one"
        await cut_at(lab, at)
        assert await outcomes(lab) == ("done", "done")
        await lab.sleep(0.3)
        words = sides(await lab.received("sink"))
        assert words == sorted(words, reverse=True) and {"old", "new"} == set(words)

    in_lab(tmp_path, main)


async def settle(lab: Lab) -> None:
    await lab.read("new", "resolve_cuts", new=True)
    await lab.read("old", "resolve_cuts", new=False)


def test_the_next_manager_settles_a_cut_that_nothing_has_passed(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        await cut_at(lab, await next_slot(lab, 0.5))
        for name, other in (("new", False), ("old", True)):
            await lab.read(name, "resolve_cuts", new=other)  # not its side
        assert await outcomes(lab, timeout=0.0) == ("waiting", "waiting")
        await settle(lab)
        assert await outcomes(lab, timeout=0.0) == ("cancelled", "cancelled")
        await lab.sleep(1.0)
        assert set(sides(await lab.received("sink"))) == {"old"}

    in_lab(tmp_path, main)


def test_the_next_manager_waits_for_a_cut_whose_new_side_has_written(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
        simulator.faults.fail_next("old", "taken", "delayed_request", 1, 0, 0.2)
        await cut_at(lab, await next_slot(lab, 0.1))
        await lab.eventually("the new side has written", lambda: written(lab))
        await settle(lab)
        assert await outcomes(lab, timeout=0.0) == ("done", "done")

    in_lab(tmp_path, main)


async def written(lab: Lab) -> bool:
    return "new" in sides(await lab.received("sink"))
