"""The agent of a node without Midstride's API: the commands of a hand-over, on plain processes behind their gates."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TypeVar

import pytest
from msgspec import structs

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import CommandRefused
from midstride.foreign import reported_states
from midstride.foreign.gated_agent import ForeignAgent
from midstride.foreign.gates import Gates
from midstride.foreign.graph_check import NodeGraph
from midstride.foreign.page import Page
from midstride.foreign.record import ForeignRecord
from midstride.model.action import Swap
from midstride.model.component import ComponentSpec, FunctionalitySpec, Mode, PortRef
from midstride.model.contract import Predicate
from midstride.runtime.handover.probation import Probation
from midstride.runtime.manager_clock import SystemClock
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire import commands, replies
from midstride.wire.sockets import SocketFolder
from tests.foreign.lab import Lab

TOPIC, TOKEN = "/chat", "a token"
TALK = FunctionalitySpec(
    "talk",
    (Mode("normal", guarantees={"out": Predicate("std_msgs/msg/String", rate=200)}), Mode("degraded")),  # type: ignore[arg-type]
    outputs=("out",),
)
TALKER = ComponentSpec.of("Talker", outputs=("out",), functionalities=(TALK,), run="talker", gate="preload")


class Nodes:
    """Nodes at 200 Hz with their agents, and a manager's connections to these."""

    def __init__(self, folder: Path, programs: Path, library: Path, graph: NodeGraph | None = None) -> None:
        self.folder = folder / "gates"
        self.folder.mkdir()
        self.graph = graph
        self.lab = Lab(self.folder, programs, library)
        self.transport = SocketFolder(folder / "components")
        self.agents: dict[str, ForeignAgent] = {}
        self.client = ComponentClient(self.transport, SystemClock(), TOKEN)

    async def start(self, instance: str) -> None:
        lab = self.lab
        index = lab.page.allocate(instance)
        Gates(lab.page, index, TALKER).prepare({"out": TOPIC})
        await asyncio.to_thread(lab.run, index, 5_000_000, 10**12)
        record = ForeignRecord(
            instance=instance,
            node=f"/{instance}",
            token=TOKEN,
            uuid=instance,
            pid=lab.processes[index].pid,
            started=time.time_ns(),
            declaration=NamedComponentForm.of(TALKER),
            index=index,
            topics={"out": TOPIC},
            modes={"talk": "degraded"},
        )
        record.write(self.folder)
        await self.answer(instance)
        await self.client.registered(instance)
        await self.change(instance, commands.WelcomeCommand(manager="a test"))

    async def answer(self, instance: str) -> None:
        """An agent for what is in the record: a manager's first one, or the next manager's."""
        record = ForeignRecord.read(self.folder, instance)
        assert record is not None and record.index is not None
        gates = Gates(self.lab.page, record.index, TALKER)
        agent = self.agents[instance] = ForeignAgent(record, self.folder, gates, graph=self.graph)
        await agent.open(self.transport)

    async def change(self, instance: str, command: commands.Command[commands.R_co]) -> commands.R_co:
        return await self.client.change(instance, command)

    async def attach(self, instance: str, gate: str) -> None:
        attach = commands.AttachCommand(port="out", topic=TOPIC, gate=gate, peers=3)  # type: ignore[arg-type]
        assert (await self.change(instance, attach)).matched == 3
        await self.change(instance, commands.ModesCommand(modes={"talk": "normal"}))

    def index(self, instance: str) -> int:
        index = self.agents[instance].node.record.index
        assert index is not None
        return index

    async def cut(self, old: str, new: str) -> None:
        swaps = [commands.CutSwap(port="out", topic=TOPIC)]
        await self.change(old, commands.CutOutCommand(cut="c", swaps=swaps, at=0, resume_after=1))
        await self.change(new, commands.CutInCommand(cut="c", swaps=swaps, at=0, peer=old, address=""))

    async def results(self, *instances: str) -> list[replies.CutResult]:
        await_cut = commands.AwaitCutCommand(cut="c", timeout=30)
        return await asyncio.gather(*(self.client.read(each, await_cut) for each in instances))

    async def handed_over(self, old: str, new: str) -> replies.CutResult:
        """Hand over; the old side's result."""
        await self.cut(old, new)
        incoming, outgoing = await self.results(new, old)
        assert (incoming.outcome, outgoing.outcome) == ("done", "done")
        # The manager compares what was reported with its model now.
        assert (self.reported(old), self.reported(new)) == ("closed", "open")
        return outgoing

    def reported(self, instance: str) -> str | None:
        latest = self.client.life.latest(instance)
        return None if latest is None else latest.state.ports["out"][TOPIC].gate

    async def gate(self, instance: str) -> str | None:
        return (await self.client.observe(instance)).ports["out"][TOPIC].gate

    async def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < deadline, "it did not come true in time"
            await asyncio.sleep(0.005)

    async def publishes(self, instance: str) -> None:
        before = self.lab.written_by(self.index(instance))
        await self.until(lambda: self.lab.written_by(self.index(instance)) > before + 3)


AnyNodes = TypeVar("AnyNodes", bound=Nodes)


@asynccontextmanager
async def nodes(folder: Path, programs: Path, library: Path) -> AsyncIterator[Nodes]:
    async with running(Nodes(folder, programs, library)) as made:
        yield made


@asynccontextmanager
async def running(made: AnyNodes) -> AsyncIterator[AnyNodes]:
    """The nodes with the old one's gate open, and the new one's closed."""
    try:
        await made.start("old")
        await made.attach("old", "open")
        await made.publishes("old")
        await made.start("new")
        await made.attach("new", "closed")
        yield made
    finally:
        made.client.close()
        for agent in made.agents.values():
            await agent.close()
        made.lab.close()


def test_a_hand_over_and_the_way_back(tmp_path: Path, programs: Path, gate_library: Path) -> None:
    async def scenario() -> None:
        async with nodes(tmp_path, programs, gate_library) as system:
            probation = commands.AwaitWriteCommand(port="out", topic=TOPIC, calls=3, patience=5)
            assert (await system.client.read("new", probation)).gated > 0
            assert (await system.gate("old"), await system.gate("new")) == ("open", "closed")
            decided = [(port.baton, port.flags) for port in map(system.lab.port, map(system.index, ("old", "new")))]
            outgoing = await system.handed_over("old", "new")
            last = outgoing.last[f"out {TOPIC}"]
            assert last is not None and last.number == system.lab.written_by(system.index("old"))
            assert (await system.gate("old"), await system.gate("new")) == ("closed", "open")
            await system.publishes("new")
            await system.change("new", commands.CancelCutCommand(cut="c"))  # a roll-back
            await system.change("old", commands.CancelCutCommand(cut="c"))
            again = [(port.baton, port.flags) for port in map(system.lab.port, map(system.index, ("old", "new")))]
            assert again == decided
            assert (await system.gate("old"), await system.gate("new")) == ("open", "closed")
            await system.publishes("old")
            await system.handed_over("old", "new")
            detached = await system.change("old", commands.DetachCommand(port="out", topic=TOPIC))
            assert detached.last == system.lab.written_by(system.index("old"))
            assert system.lab.word(system.lab.port(system.index("new")).baton).predecessor == 0
            assert system.lab.overlaps() == 0

    asyncio.run(scenario())


def test_another_manager_goes_on(tmp_path: Path, programs: Path, gate_library: Path) -> None:
    async def scenario() -> None:
        async with nodes(tmp_path, programs, gate_library) as system:
            os.kill(system.lab.processes[system.index("new")].pid, signal.SIGSTOP)
            baton = system.lab.port(system.index("old")).baton
            await system.cut("old", "new")
            await system.agents["old"].close()  # its manager ends in the middle
            await system.until(lambda: system.lab.word(baton).holder == system.index("old") + 1)
            await system.publishes("old")
            await system.answer("old")
            state = await system.client.observe("old")
            assert (state.functionalities["talk"].mode, state.waiting) == ("normal", None)
            assert state.ports["out"][TOPIC].gate == "open"
            assert not system.lab.word(baton).successor

    asyncio.run(scenario())


def test_one_that_hangs_is_fenced(tmp_path: Path, programs: Path, gate_library: Path) -> None:
    async def scenario() -> None:
        async with nodes(tmp_path, programs, gate_library) as system:
            index = system.index("old")
            assert (await system.client.read("old", commands.AwaitIdleCommand())).busy is None
            fence = commands.FenceCommand(attachments=[("out", TOPIC)])
            await system.client.read("old", fence)
            before = system.lab.written_by(index)
            gated = system.lab.port(index).gated
            await system.until(lambda: system.lab.port(index).gated > gated + 3)
            assert system.lab.written_by(index) == before
            assert (await system.client.observe("old")).ports["out"][TOPIC].fenced
            await system.client.read("old", commands.FenceCommand(attachments=[("out", TOPIC)], lift=True))
            await system.publishes("old")
            os.kill(system.lab.processes[index].pid, signal.SIGSTOP)
            while (await system.client.read("old", commands.AwaitIdleCommand())).busy is None:
                await asyncio.sleep(0.05)

    asyncio.run(scenario())


@pytest.mark.full
def test_one_that_hangs_on_a_clock_that_moves_is_fenced(
    tmp_path: Path, programs: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not while the simulation is paused, and not before it is known how its clock moves."""
    monkeypatch.setattr(reported_states, "UNNOTICED", 0.5)

    async def scenario() -> None:
        async with nodes(tmp_path, programs, gate_library) as system:
            agent, clock = system.agents["old"], system.agents["old"].node.others
            agent.node.change_record(stated={"use_sim_time": True})
            os.kill(system.lab.processes[system.index("old")].pid, signal.SIGSTOP)
            for speed in (None, 0.0, 1.0):
                for _ in range(20):
                    if speed is not None:
                        clock.note(structs.replace(agent.node.state(), simulated_time=True, clock_speed=speed))
                    state = await system.client.peek("old")
                    assert (state.simulated_time, state.clock_speed) == (True, speed or 0.0)
                    busy = (await system.client.read("old", commands.AwaitIdleCommand())).busy
                    if speed:
                        break
                    assert busy is None, busy
                    await asyncio.sleep(0.1)
            while busy is None:
                await asyncio.sleep(0.05)
                clock.note(structs.replace(agent.node.state(), simulated_time=True, clock_speed=1.0))
                busy = (await system.client.read("old", commands.AwaitIdleCommand())).busy
            assert busy.startswith(f"it has written nothing on {TOPIC} for ")

    asyncio.run(scenario())


def test_what_it_cannot_do_is_refused(tmp_path: Path, programs: Path, gate_library: Path) -> None:
    async def scenario() -> None:
        async with nodes(tmp_path, programs, gate_library) as system:
            detach = commands.DetachCommand(port="out", topic=TOPIC)
            await system.change("new", detach)
            for command, words in (
                (commands.AttachCommand(port="out", topic="/other"), "fixed at its start"),
                (commands.AttachCommand(port="in", topic=TOPIC), "there is no port in"),
                (detach, "is not attached"),
                (commands.ModesCommand(modes={"talk": "slow"}), "no functionality talk with a mode 'slow'"),
                (commands.SetParametersCommand(parameters={"a": 1}), "does not use Midstride's API"),
                (commands.AttachCommand(port="out", topic=TOPIC, peers=9, timeout=0.1), "only 3 of 9 endpoints"),
            ):
                with pytest.raises(CommandRefused, match=words):
                    await system.change("new", command)
            stranger = ComponentClient(system.transport, SystemClock(), "another token")
            with pytest.raises(CommandRefused, match="token"):
                await stranger.observe("new")
            stranger.close()

    asyncio.run(scenario())


def test_by_default_a_node_must_keep_its_rate_for_a_moment(tmp_path: Path, programs: Path, gate_library: Path) -> None:
    """Both write at 200 Hz, the new one behind its gate."""

    async def nothing(_: str) -> str:
        return ""

    async def scenario() -> None:
        async with nodes(tmp_path, programs, gate_library) as system:
            swap = Swap(TOPIC, PortRef("old", "out"), PortRef("new", "out"))

            async def judged(rate: float, timing: dict[str, float]) -> None:
                probation = Probation(system.client, swap, TOPIC, rate, False, timing, nothing)
                assert await probation.run() == "writes"

            async def keeps(rate: float, known_clock: bool = True) -> bool:
                asked = commands.AwaitRateCommand(
                    port="out", topic=TOPIC, rate=rate, window=0.2, until="met", timeout=0.3, known_clock=known_clock
                )
                return (await system.client.read("new", asked)).reached

            await judged(200.0, {})
            await judged(1000.0, {})  # the old one does not keep it either
            await judged(1000.0, {"probation": 0.0})
            assert (await keeps(200.0), await keeps(1000.0)) == (True, False)
            system.agents["new"].node.change_record(stated={"use_sim_time": True})
            assert await keeps(1000.0)  # on `/clock`, which the page does not know
            assert not await keeps(1000.0, known_clock=False)

    asyncio.run(scenario())


def test_an_output_with_a_rate_has_half_its_period_in_the_page(tmp_path: Path, gate_library: Path) -> None:
    page = Page(tmp_path / "page", gate_library)
    gates = Gates(page, page.allocate("node"), TALKER)
    gates.prepare({"out": TOPIC})
    assert gates.entry("out").half == 2500  # us, at 200 Hz
