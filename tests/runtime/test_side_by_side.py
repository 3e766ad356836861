"""Hand-overs that commute: they are prepared and watched at once, and cut one after another, all or none."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from tests.runtime.counting import Reader
from tests.runtime.side_by_side import NODES, all_replaced, managed, program, three

# How the new component writes: put before its only write. It is called at 20 Hz.
SLOW = "calls.append(1)\n        if len(calls) % 2: return"
SLOW_FOR_3_SECONDS = "calls.append(1)\n        if len(calls) < 60 and len(calls) % 2: return"
RAISES_WHEN_LIVE = "calls.append(comp.is_live)\n        if calls.count(True) == 20: raise ValueError('now')"
# Twelve periods: the most that the messages of a cut that is given up come late.
LONGEST_GAP = 0.6

Meanwhile = Callable[[Manager, Simulator], Awaitable[None]]


class Changed:
    """What came of a change: the outcome, the time it took, and what each reader has heard."""

    outcome: Outcome
    took: float
    readers: dict[str, Reader]
    events: list[tuple[str, str]]
    manager: Manager

    def assert_no_message_missed(self) -> None:
        for reader in self.readers.values():
            reader.assert_exactly_once()
            assert reader.longest_gap() <= LONGEST_GAP

    def sides(self, node: str) -> list[str]:
        """Which instances have written on the topic of ``node``, in turn."""
        words = [word.split()[1] for word in self.readers[node].words]
        return [word for index, word in enumerate(words) if index == 0 or words[index - 1] != word]

    def at(self, kind: str, index: int) -> float:
        return next(event.at for event in self.manager.log() if event.kind == kind and event.index == index)


def change(
    folder: Path,
    specification: Specification,
    request: PlanRequest | None = None,
    meanwhile: Meanwhile | None = None,
) -> Changed:
    async def body(manager: Manager, simulator: Simulator, readers: dict[str, Reader]) -> Changed:
        found = Changed()
        begun = simulator.clock.steady()
        changing = asyncio.ensure_future(manager.change(request or all_replaced()))
        if meanwhile is not None:
            while not any(event.kind == "step" and "hand over" in event.words for event in manager.log()):
                await asyncio.sleep(0.01)
            await meanwhile(manager, simulator)
        found.outcome, found.readers, found.manager = await changing, readers, manager
        found.took = simulator.clock.steady() - begun
        found.events = [(event.kind, event.words) for event in manager.log()]
        await asyncio.sleep(1)
        status = await manager.status()
        assert status.valid, status
        return found

    return managed(folder, specification, body)


def test_three_hand_overs_take_as_long_as_one_probation_and_three_cuts(tmp_path: Path) -> None:
    found = change(tmp_path, three(tmp_path, probation=5.0, watch_after=2.0))
    assert (found.outcome.outcome, found.outcome.because) == ("done", None)
    found.assert_no_message_missed()
    assert [found.sides(node) for node in NODES] == [[node, f"{node}_2"] for node in NODES]
    assert found.outcome.plan is not None
    handed_over = [time for time in found.outcome.steps if found.outcome.plan.steps[time.step - 1].action == "handover"]
    assert len(handed_over) == 3 and len({time.began for time in handed_over}) == 1
    assert 7.0 <= max(time.seconds for time in handed_over) < 7.0 + 3 * 0.4
    created = 1.0  # in the plan; here a process starts at once
    assert found.outcome.plan.duration == pytest.approx(found.outcome.seconds + created, abs=0.5)
    assert found.outcome.plan.seconds > found.outcome.seconds + 13
    assert [swap.missed for swap in found.outcome.swaps] == [0] * 3


def test_the_cuts_follow_one_another(tmp_path: Path) -> None:
    """No message of two topics comes from the new side of the later one before all are of the earlier one's."""
    found = change(tmp_path, three(tmp_path))
    assert found.outcome.outcome == "done"
    found.assert_no_message_missed()
    first = [
        next(at for at, word in zip(reader.times, reader.words, strict=True) if word.endswith("_2"))
        for reader in (found.readers[node] for node in NODES)
    ]
    assert first == sorted(first) and min(first[1] - first[0], first[2] - first[1]) > 0.05


def test_where_one_does_not_keep_its_rate_no_topic_is_touched(tmp_path: Path) -> None:
    specification = three(tmp_path, {"second": program(SLOW)}, probation=1.0, probation_timeout=3.0)
    found = change(tmp_path, specification)
    assert found.outcome.outcome == "rolled_back"
    assert str(found.outcome.because).startswith(
        "hand over /second from second.out to second_2.out: second_2.out does not keep"
    )
    assert "/first" not in str(found.outcome.because), "what waited for it is not to blame"
    found.assert_no_message_missed()
    assert [found.sides(node) for node in NODES] == [[node] for node in NODES]
    failed = [words for kind, words in found.events if kind == "step_failed"]
    assert [words.rpartition(" ")[0] for words in failed if words.endswith("given up")] == [
        "hand over /first from first.out to first_2.out given",
        "hand over /third from third.out to third_2.out given",
    ]


def test_one_that_fails_at_once_is_not_waited_for(tmp_path: Path) -> None:
    raising = program("raise ValueError('behind the gate')")
    found = change(tmp_path, three(tmp_path, {"third": raising}, probation=30.0))
    assert found.outcome.outcome == "rolled_back" and "behind the gate" in str(found.outcome.because)
    assert found.took < 5
    found.assert_no_message_missed()


def test_one_that_fails_while_it_is_watched_has_all_handed_back(tmp_path: Path) -> None:
    found = change(tmp_path, three(tmp_path, {"first": program(RAISES_WHEN_LIVE)}, watch_after=30.0))
    assert found.outcome.outcome == "rolled_back" and "ValueError: now" in str(found.outcome.because)
    assert found.took < 8, "the others are not watched to the end"
    for node in ("second", "third"):
        assert found.sides(node) == [node, f"{node}_2", node]
        found.readers[node].assert_exactly_once()
    assert found.sides("first")[-1] == "first"


def test_a_cut_that_fails_leaves_the_later_ones_and_has_the_earlier_ones_handed_back(tmp_path: Path) -> None:
    async def refuse(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.fail_next("second_2", "cut_in", "refused", times=9)

    found = change(tmp_path, three(tmp_path), meanwhile=refuse)
    assert found.outcome.outcome == "rolled_back"
    found.assert_no_message_missed()
    assert [found.sides(node) for node in NODES] == [["first", "first_2", "first"], ["second"], ["third"]]


def test_a_node_that_exits_while_its_new_one_waits_is_taken_over_from_at_once(tmp_path: Path) -> None:
    async def kill(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(1.5)
        simulator.faults.kill("first")

    specification = three(tmp_path, {"third": program(SLOW_FOR_3_SECONDS)}, probation=1.0)
    found = change(tmp_path, specification, meanwhile=kill)
    assert (found.outcome.outcome, found.outcome.because) == ("done", None)
    assert found.sides("first") == ["first", "first_2"]
    assert found.readers["first"].longest_gap() < 0.3
    for node in ("second", "third"):
        found.readers[node].assert_exactly_once()


def test_a_crash_of_another_node_is_responded_to_while_they_wait(tmp_path: Path) -> None:
    """Only two are replaced; the sink hears the third, and its functionality needs one of the topics no more."""
    lowered: list[float] = []

    async def kill(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(0.5)
        killed = simulator.clock.steady()
        simulator.faults.kill("third")
        while not any(event.kind == "degraded" and "ear" in event.words for event in manager.log()):
            await asyncio.sleep(0.01)
        lowered.append(simulator.clock.steady() - killed)

    specification = three(tmp_path, probation=5.0)
    sink = specification.nodes["sink"]
    attachments = sink.attachments.set("in", ("/third",))
    specification = specification.with_node(type(sink)("ear", "Sink", attachments))
    found = change(tmp_path, specification, all_replaced("first", "second"), kill)
    assert found.outcome.outcome == "done" and found.outcome.unexpected_exits == ["third"]
    assert lowered[0] < 0.5
    for node in ("first", "second"):
        assert found.sides(node) == [node, f"{node}_2"]
        found.readers[node].assert_exactly_once()


def test_a_manager_that_is_to_end_hands_nothing_over(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, readers: dict[str, Reader]) -> None:
        changing = asyncio.ensure_future(manager.change(all_replaced()))
        await asyncio.sleep(3)
        asked = simulator.clock.steady()
        changing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await changing
        assert simulator.clock.steady() - asked < 5
        assert sorted(manager.configuration.instances) == sorted([*NODES, "sink"])
        await asyncio.sleep(1)
        for node, reader in readers.items():
            reader.assert_exactly_once()
            assert {word.split()[1] for word in reader.words} == {node}

    managed(tmp_path, three(tmp_path, probation=20.0), body)
