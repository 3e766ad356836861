"""The state of nodes without Midstride's API: between two processes behind their gates, and of simulated nodes."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import pytest

from midstride.errors import CommandRefused
from midstride.foreign.foreign_state import StatePeers
from midstride.foreign.gated_agent import ForeignAgent
from midstride.foreign.gates import Gates
from midstride.foreign.page_layout import PortFlag
from midstride.foreign.record import ForeignRecord
from midstride.model.action import Handover
from midstride.node.handover.baton import BatonStep
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.wire import commands, replies
from tests.foreign import simulated
from tests.foreign.chat import chat
from tests.foreign.simulated import SimulatedNode, SimulatedRos
from tests.foreign.test_agent import TALKER, TOPIC, Nodes, running

TRANSFER = commands.StateTransfer(id="t", cuts=1, at=0, timeout=0.4)
SWAPS = [commands.CutSwap(port="out", topic=TOPIC)]


class StatefulNodes(Nodes):
    """Their state is simulated; ``offers``: those that have the two services."""

    def __init__(self, folder: Path, programs: Path, library: Path) -> None:
        super().__init__(folder, programs, library)
        self.states = StatePeers()
        self.events: list[str] = []
        self.behind: dict[str, SimulatedNode] = {}

    async def answer(self, instance: str) -> None:
        record = ForeignRecord.read(self.folder, instance)
        assert record is not None and record.index is not None
        kept = f"of {instance}".encode()
        node = self.behind.setdefault(instance, SimulatedNode(instance, self.events, kept=kept))
        gates = Gates(self.lab.page, record.index, TALKER)
        agent = self.agents[instance] = ForeignAgent(
            record, self.folder, gates, node, served=node.served, states=self.states
        )
        await agent.open(self.transport)

    async def hands_over(self, swaps: list[commands.CutSwap] = SWAPS) -> list[replies.CutResult]:
        """The results of the new side and the old one, of a cut at which state moves."""
        cut_out = commands.CutOutCommand(cut="c", swaps=swaps, at=0, resume_after=1, state=TRANSFER)
        await self.change("old", cut_out)
        cut_in = commands.CutInCommand(cut="c", swaps=swaps, at=0, peer="old", address="", state=TRANSFER)
        await self.change("new", cut_in)
        return await self.results("new", "old")

    async def cancelled(self) -> None:
        for side in ("new", "old"):
            await self.change(side, commands.CancelCutCommand(cut="c"))


Body = Callable[[StatefulNodes], Awaitable[None]]


@pytest.fixture
def between(tmp_path: Path, programs: Path, gate_library: Path) -> Callable[[Body], None]:
    def run(body: Body) -> None:
        async def scenario() -> None:
            async with running(StatefulNodes(tmp_path, programs, gate_library)) as system:
                await body(system)
                assert system.lab.overlaps() == 0

        asyncio.run(scenario())

    return run


def test_state_moves_between_the_last_message_and_the_first(between: Callable[[Body], None]) -> None:
    async def body(system: StatefulNodes) -> None:
        offer = await system.change("new", commands.PrepareStateCommand(peer="old", address=""))
        assert offer.exports == "whole"
        new, old = await system.hands_over()
        assert (new.outcome, old.outcome, new.because) == ("done", "done", None)
        assert system.events == ["old exported", "new imported of old"]
        assert new.moved is not None and new.moved.bytes == len(b"of old")
        last, first = old.last[f"out {TOPIC}"], new.first[f"out {TOPIC}"]
        assert last is not None and last.number == system.lab.written_by(system.index("old"))
        assert first is not None and new.moved.silent is not None
        writers = [writer for writer, _, _ in system.lab.records()]
        assert writers == sorted(writers), "the old one wrote after the new one"
        assert (await system.gate("old"), await system.gate("new")) == ("closed", "open")
        await system.change("old", commands.DetachCommand(port="out", topic=TOPIC))
        await system.publishes("new")

    between(body)


@pytest.mark.parametrize(
    ("side", "behaviour", "words"),
    [
        ("old", {"hangs": {"export"}}, "old has not exported its state: old has not answered within 0.4 s"),
        ("old", {"no_export": "the map is being saved"}, "old has not exported its state: the map is being saved"),
        ("new", {"no_import": "of another version"}, "new has not imported the state: of another version"),
        ("new", {"hangs": {"import"}}, "new has not imported the state: new has not answered within"),
    ],
)
def test_the_old_one_goes_on_where_state_does_not_move(
    between: Callable[[Body], None], side: str, behaviour: Mapping[str, Any], words: str
) -> None:
    async def body(system: StatefulNodes) -> None:
        for name, value in behaviour.items():
            setattr(system.behind[side], name, value)
        new, old = await system.hands_over()
        assert (new.outcome, old.outcome) == ("waiting", "waiting")
        assert new.because is not None and new.because.startswith(words)
        await system.publishes("old")  # before the manager has cancelled anything
        await system.cancelled()
        assert (await system.gate("old"), await system.gate("new")) == ("open", "closed")
        await system.publishes("old")
        assert system.lab.written_by(system.index("new")) == 0
        for name in behaviour:  # and once more, as it should
            setattr(system.behind[side], name, None if name.startswith("no_") else set())
        new, _ = await system.hands_over()
        assert (new.outcome, new.because) == ("done", None)

    between(body)


def test_state_moves_where_no_topic_is_handed_over(between: Callable[[Body], None]) -> None:
    async def body(system: StatefulNodes) -> None:
        new, old = await system.hands_over([])
        assert (new.outcome, old.outcome, new.because) == ("done", "done", None)
        assert new.moved is not None and new.moved.silent is None
        assert system.events == ["old exported", "new imported of old"]
        assert (await system.gate("old"), await system.gate("new")) == ("open", "closed")
        await system.cancelled()
        await system.publishes("old")

    between(body)


def test_a_node_that_cannot_import_is_refused_beforehand(between: Callable[[Body], None]) -> None:
    async def body(system: StatefulNodes) -> None:
        prepare = commands.PrepareStateCommand(peer="old", address="")
        system.behind["new"].kept = None
        words = r"new cannot import state: its node offers no service /new/midstride/import_state \(rcl_interfaces/srv"
        with pytest.raises(CommandRefused, match=words):
            await system.change("new", prepare)
        system.behind["old"].kept = None
        assert (await system.change("new", prepare)).exports == "nothing"

    between(body)


def test_the_old_one_goes_on_without_a_manager(between: Callable[[Body], None]) -> None:
    """The manager ends while the old node exports, and has withdrawn nothing."""

    async def body(system: StatefulNodes) -> None:
        old = system.index("old")
        system.behind["old"].hangs.add("export")
        transfer = commands.StateTransfer(id="t", cuts=1, at=0, timeout=0.05)
        gates = system.agents["old"].node.gates
        assert gates is not None
        await system.change("old", commands.CutOutCommand(cut="c", swaps=SWAPS, at=0, resume_after=1, state=transfer))
        baton = gates.baton("out")
        gates.page.layout.batons[baton - 1].patience = 300_000_000
        before = system.lab.port(old).gated
        gates.page.step(baton, BatonStep.NAME_SUCCESSOR, old, system.index("new"), at_once=True)
        await system.until(lambda: system.lab.port(old).gated > before + 3)
        await system.publishes("old")
        assert system.lab.word(baton).holder == old + 1

    between(body)


def test_what_the_new_one_wrote_with_its_own_state_is_forgotten(between: Callable[[Body], None]) -> None:
    """An output without a rate keeps its last message behind the gate; not one of before the import."""

    async def body(system: StatefulNodes) -> None:
        gates = system.agents["new"].node.gates
        assert gates is not None
        entry = gates.entry("out")
        entry.flags = PortFlag.KEEPS
        await system.until(lambda: bool(entry.kept))
        gates.wait_for_manager(["out"], keeping=False)
        await system.until(lambda: not entry.kept)

    between(body)


def test_a_node_is_asked_once_to_import_one_state(between: Callable[[Body], None]) -> None:
    """Also by the agent of the next manager, which cannot know whether the node has heard the last one."""

    async def body(system: StatefulNodes) -> None:
        node = system.behind["new"]

        async def imports(exporter: str) -> None:
            await system.change("new", commands.ImportStateCommand(state=b"41", timeout=0.1, exporter=exporter))

        async def next_manager() -> None:
            await system.agents["new"].close()
            await system.answer("new")
            system.client.disconnect("new")

        def imported() -> int:
            return system.events.count("new imported 41")

        node.no_import = "of another version"
        with pytest.raises(CommandRefused, match="of another version"):
            await imports("a")
        node.no_import = None
        await imports("a")
        await next_manager()
        await imports("a")
        assert imported() == 1
        node.hangs.add("import")
        with pytest.raises(CommandRefused, match="has not answered within"):
            await imports("b")
        node.hangs.clear()
        await next_manager()
        with pytest.raises(CommandRefused, match="may have imported it, so it is not asked again"):
            await imports("b")
        assert imported() == 1
        await imports("c")
        assert imported() == 2

    between(body)


# -- without a gate inside, in virtual time --------------------------------------------------------------------------

KEPT = {"Talker": {"kept": b"41"}, "Other": {"kept": b""}}
PAPER = PlanRequest(replace=(("talker", "Other"),), strategy="paper")
REPLACE = PlanRequest(replace=(("talker", "Other"),))


@pytest.mark.parametrize("request_", [REPLACE, PAPER], ids=["hand-over", "paper"])
def test_a_lifecycle_node_passes_its_state_on(tmp_path: Path, request_: PlanRequest) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> Outcome:
        outcome = await manager.change(request_)
        states = [each for each in simulator.events if "ported" in each]
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert states == ["talker exported", "talker_2 imported 41"]
        if request_ is REPLACE:
            begun, ended = simulator.events.index("talker deactivate"), simulator.events.index("talker_2 activate")
            assert begun < simulator.events.index(states[0]) < simulator.events.index(states[1]) < ended
        return outcome

    outcome = simulated.managed(tmp_path, chat("lifecycle"), body, KEPT)
    assert outcome.own_state == {}
    assert [*outcome.moved] == (["talker_2"] if request_ is REPLACE else [])


@pytest.mark.parametrize("request_", [REPLACE, PAPER], ids=["hand-over", "paper"])
def test_a_lifecycle_node_that_refuses_the_state_is_not_kept(tmp_path: Path, request_: PlanRequest) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> Outcome:
        outcome = await manager.change(request_)
        assert simulator.of("talker").kept == b"41"
        assert simulator.of("talker").state == "active"
        return outcome

    behaviour: dict[str, dict[str, Any]] = {
        "Talker": {"kept": b"41"},
        "Other": {"kept": b"", "no_import": "of another version"},
    }
    outcome = simulated.managed(tmp_path, chat("lifecycle"), body, behaviour)
    assert outcome.outcome == "rolled_back"
    assert outcome.because is not None and "has not imported the state: of another version" in outcome.because


@pytest.mark.parametrize("strategy", ["minimal", "paper"])
def test_without_a_gate_the_old_node_has_to_end_first(tmp_path: Path, strategy: Literal["minimal", "paper"]) -> None:
    """A node without ports, which is replaced beside the old one by default."""
    text = """system plain
component Talker { run "talker" gate none }
component Other { run "other" gate none }
node talker : Talker
"""
    request = PlanRequest(replace=(("talker", "Other"),), strategy=strategy)

    async def body(manager: Manager, simulator: SimulatedRos) -> list[str]:
        await asyncio.sleep(3)  # the graph has shown it
        plan = await manager.plan(request)
        outcome = await manager.change(request)
        assert outcome.outcome == "done", outcome.because
        assert [each for each in simulator.events if "imported" in each] == (
            ["talker_2 imported 41"] if strategy == "paper" else []
        )
        said = [each.words for each in plan.besides if "the state of talker is lost" in each.words]
        return [*said, *outcome.own_state.values()]

    found = simulated.managed(tmp_path, text, body, KEPT)
    assert len(found) == (2 if strategy == "minimal" else 0), found
    assert all("`--strategy paper` moves it" in words for words in found)


def test_after_a_crash_the_report_says_that_the_state_is_lost(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> Outcome:
        await asyncio.sleep(3)  # the graph has shown it
        simulator.die("talker")
        await asyncio.sleep(1)
        return await manager.change(PlanRequest(restart=("talker",)))

    outcome = simulated.managed(tmp_path, chat("lifecycle"), body, KEPT)
    assert outcome.outcome == "done"
    ((name, words),) = outcome.own_state.items()
    assert name.startswith("talker")
    assert "talker exited before it had exported its state" in words


def test_the_plan_says_what_waits_for_the_state(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await asyncio.sleep(3)  # the graph has shown it
        (silence,) = [each for each in (await manager.plan(REPLACE)).besides if "while the state of" in each.words]
        assert (silence.verdict, silence.seconds, silence.at_most) == ("lost", 2.0, True)
        assert "nothing is published on /chat" in silence.words
        assert not [each for each in (await manager.plan(PAPER)).besides if "the state of" in each.words]

    simulated.managed(tmp_path, chat("lifecycle"), body, KEPT)


@pytest.mark.parametrize("stated", [1.0, 9.0])
def test_the_specification_states_how_long_state_may_take(stated: float, tmp_path: Path) -> None:
    """The old node takes 5 s to export it."""

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await asyncio.sleep(3)  # the graph has shown it
        plan = await manager.plan(REPLACE)
        (silence,) = [each for each in plan.besides if "while the state of" in each.words]
        assert silence.seconds == stated
        (step,) = [step for step in plan.steps if isinstance(step.action, Handover)]
        assert step.between is not None and step.between[1] - step.between[0] >= stated
        outcome = await manager.change(REPLACE)
        if stated > 5:
            assert (outcome.outcome, outcome.because, outcome.own_state) == ("done", None, {})
            assert simulator.of("talker").kept == b"41"
        else:
            assert outcome.outcome == "rolled_back"
            assert "has not answered within 1 s" in str(outcome.because)

    text = f"{chat('lifecycle')}timing {{ state_timeout {stated:g} s }}\n"
    behaviour: dict[str, dict[str, Any]] = {**KEPT, "Talker": {"kept": b"41", "slow": {"export": 5.0}}}
    simulated.managed(tmp_path, text, body, behaviour)
