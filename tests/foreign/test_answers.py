"""Nodes that answer messages, in plain processes: whether they are seen to do so, and one answer for each message."""

from __future__ import annotations

import asyncio
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.foreign.foreign_state import StatePeers
from midstride.foreign.gated_outputs import GatedOutputs
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode
from midstride.foreign.page import Page
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import ReportedStates
from midstride.model.component import ComponentSpec, FunctionalitySpec, Mode
from midstride.model.contract import Predicate
from midstride.node.handover.baton import BatonStep
from midstride.wire import commands
from tests.foreign.lab import MS, Lab, until

# How often a node looks for an input (ns), of which there is one each ms.
OFTEN = MS // 10
ANSWER = FunctionalitySpec(
    "answer",
    modes=(Mode("normal", guarantees={"out": Predicate("std_msgs/msg/String", rate=900)}), Mode("degraded")),  # type: ignore[arg-type]
    inputs=("in",),
    outputs=("out",),
)
COMPONENT = ComponentSpec.of(
    "Answerer",
    inputs={"in": Predicate("std_msgs/msg/String")},
    outputs=("out",),
    functionalities=(ANSWER,),
    run="answerer",
    gate="preload",
)


class AnsweringLab(Lab):
    """Nodes that take numbered messages, and publish what they make of them."""

    def answering(self, *way: str, of: int | None = None) -> Gates:
        """Start a node that does so in this ``way``, behind its gate. ``of``: the index of one of the same role."""
        gates = Gates(self.page, self.page.allocate("answerer"), COMPONENT)
        gates.prepare({"out": "/chat", "in": "/numbers"}, of)
        self.run(gates.index, OFTEN, 10**12, "/numbers", *way)
        return gates

    def first(self, *way: str) -> Gates:
        gates = self.answering(*way)
        gates.share(["out"])
        gates.set_gate("out", True)
        publishes(gates)
        return gates

    def handed_over(self, old: Gates, new: Gates) -> None:
        until(lambda: new.answers_as(old.index, ["out"]), "they are not seen to answer the same messages")
        baton = old.baton("out")
        new.share_answers(["out"], baton, old.index)
        new.set_gate("out", True)
        self.page.step(baton, BatonStep.NAME_SUCCESSOR, old.index, new.index, at_once=True)
        publishes(new)

    def answers(self) -> Counter[int]:
        """How many answers each message has, but for the last ones."""
        numbers = Counter(number for _, number, _ in self.records())
        return Counter({number: count for number, count in numbers.items() if number < max(numbers) - 100})

    def answered_once(self) -> None:
        found = self.answers()
        wrong = {number: found[number] for number in range(min(found), max(found)) if found[number] != 1}
        assert not wrong, wrong


def publishes(gates: Gates, messages: int = 20) -> None:
    entry = gates.entry("out")
    before = entry.passed
    until(lambda: entry.passed > before + messages, f"node {gates.index} does not publish")


@pytest.fixture
def lab(tmp_path: Path, programs: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AnsweringLab]:
    monkeypatch.setenv("FAKE_INPUT_NS", str(MS))
    made = AnsweringLab(tmp_path, programs, gate_library)
    yield made
    made.close()


def test_each_message_is_answered_once_across_replacements(lab: AnsweringLab) -> None:
    old = lab.first()
    for _ in range(10):
        new = lab.answering(of=old.index)
        lab.handed_over(old, new)
        lab.page.step(old.baton("out"), BatonStep.SETTLE, new.index)
        lab.kill(old.index)
        lab.page.free(old.index)
        old = new
    publishes(old, 200)
    lab.close()
    assert lab.overlaps() == 0
    lab.answered_once()


def test_a_node_that_lags_behind_hands_over_no_sooner_than_the_new_one_has_all_that_it_is_to_answer(
    lab: AnsweringLab,
) -> None:
    old = lab.first()
    lab.processes[old.index].send_signal(signal.SIGSTOP)
    new = lab.answering(of=old.index)
    until(lambda: new.answers_inputs("out"), "the new node does not answer")
    assert old.answers_inputs("out") and not new.answers_as(old.index, ["out"])
    lab.processes[old.index].send_signal(signal.SIGCONT)
    lab.handed_over(old, new)
    publishes(new, 200)
    lab.close()
    assert lab.overlaps() == 0
    lab.answered_once()


def test_what_a_stopped_successor_does_not_answer_the_old_one_does(lab: AnsweringLab) -> None:
    """It takes the baton back after its patience, and publishes what it has kept."""
    old = lab.first()
    new = lab.answering(of=old.index)
    until(lambda: new.answers_as(old.index, ["out"]), "they are not seen to answer the same messages")
    lab.processes[new.index].send_signal(signal.SIGSTOP)
    new.share_answers(["out"], old.baton("out"), old.index)
    lab.page.layout.batons[old.baton("out") - 1].patience = 100 * MS
    lab.page.step(old.baton("out"), BatonStep.NAME_SUCCESSOR, old.index, new.index, at_once=True)
    publishes(old, 500)
    lab.page.step(old.baton("out"), BatonStep.WITHDRAW, old.index)
    lab.close()
    lab.answered_once()


def test_a_successor_that_dies_costs_one_answer_at_most(lab: AnsweringLab) -> None:
    old = lab.first()
    new = lab.answering(of=old.index)
    lab.handed_over(old, new)
    lab.kill(new.index)
    publishes(old, 200)
    lab.close()
    found = lab.answers()
    missing = [number for number in range(min(found), max(found)) if not found[number]]
    assert max(found.values()) == 1
    assert len(missing) <= 1


@pytest.mark.parametrize("way", ["timer", "pairs", "twice"])
def test_what_is_not_one_answer_for_each_message_is_seen(lab: AnsweringLab, way: str) -> None:
    """A timer that publishes the last input, a node that waits for two inputs, and one that publishes two messages."""
    answering, other = lab.first(), lab.first(way)
    publishes(other, 50)
    assert answering.answers_inputs("out")
    assert not other.answers_inputs("out") and (way == "timer" or other.entry("out").falls > 0)
    assert not other.answers_as(answering.index, ["out"])


@pytest.mark.parametrize("way", ["", "ticks"])
def test_nothing_calls_a_node_that_is_to_be_unloaded_until_it_stays_after_all(lab: AnsweringLab, way: str) -> None:
    """Neither a message nor a timer, which it has made in a callback."""
    node = lab.first(*([way] if way else []))

    def looks(times: int) -> None:
        wanted = lab.page.beat(node.index) + times
        until(lambda: lab.page.beat(node.index) >= wanted, "its helper thread does not look")

    lab.page.leaves(node.index, True)
    looks(3)
    written = lab.written_by(node.index)
    looks(3)
    assert lab.written_by(node.index) == written
    assert bool(node.entry("in").gated) == (way == "")
    lab.page.leaves(node.index, False)
    publishes(node, 50)


def test_a_timer_of_another_thread_goes_on_in_the_place_of_one_that_the_node_has_removed(lab: AnsweringLab) -> None:
    """A removed timer is known no longer, though rcl tells the library twice of each that it makes."""
    node = lab.first("elsewhere")
    lab.page.leaves(node.index, True)
    publishes(node, 50)


def outputs_of(page: Page, instance: str, predecessor: int | None = None) -> tuple[Gates, GatedOutputs]:
    """The outputs of a node that has answered messages, without its process."""
    topics = {"out": "/chat", "in": "/numbers"}
    gates = Gates(page, page.allocate(instance), COMPONENT)
    gates.prepare(topics, predecessor)
    entry = gates.entry("out")
    entry.in_step, entry.answers, entry.overlaps = 3, 1, 1
    record = ForeignRecord(
        instance=instance,
        node=f"/{instance}",
        token="a token",
        uuid=instance,
        pid=1,
        started=0,
        declaration=NamedComponentForm.of(COMPONENT),
        index=gates.index,
        topics=topics,
        modes={"answer": "normal"},
    )
    return gates, GatedOutputs(ForeignNode(record, page.path.parent, gates, ReportedStates()), gates, StatePeers())


@pytest.mark.parametrize("falls", [None, "old", "new", "old, for a while", "new, for a while"])
def test_a_cut_is_by_input_where_the_outputs_stay_in_step(
    falls: str | None, tmp_path: Path, gate_library: Path
) -> None:
    page = Page(tmp_path / "page", gate_library)
    old, old_side = outputs_of(page, "old")
    new, new_side = outputs_of(page, "new", old.index)

    async def by_input() -> bool:
        swaps = [commands.CutSwap(port="out", topic="/chat")]
        await old_side.cut_out(commands.CutOutCommand(cut="c", swaps=swaps, at=0, resume_after=1))
        await new_side.cut_in(commands.CutInCommand(cut="c", swaps=swaps, at=0, peer="old", address=""))
        assert new.step(old.baton("out"), BatonStep.TAKE).holder == new.index + 1
        new.entry("out").passed += 1
        if falls is not None:
            entry = (old if falls.startswith("old") else new).entry("out")
            entry.in_step, entry.falls = (0 if falls in ("old", "new") else 90), entry.falls + 1
        result = await new_side.await_cut(commands.AwaitCutCommand(cut="c", timeout=30))
        assert result.outcome == "done"
        assert result.out_of_step == (falls is not None)
        return result.by_input

    assert asyncio.run(by_input()) == (falls is None)
