"""A component that hands over to a node with a gate, or takes over from one: both sides in virtual time.

The node is played by a writer at the slot of a second node: so it takes the same steps as the preloaded library.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.foreign.gates import share_baton
from midstride.foreign.page import Page
from midstride.foreign.page_layout import OPEN, OUTPUT
from midstride.node.handover.baton import BatonState, BatonStep, SharedSlot
from midstride.wire.replies import SharedSlotPlace
from tests.conformance import puppets
from tests.conformance.lab import Lab

TOPIC = "/chatter"
SWAPS = [{"port": "out", "topic": TOPIC}]
PERIOD = 0.05  # of both
GATED = "gated"


class Gated:
    """A node with a gate, its page, and what was heard: when, and of which side."""

    def __init__(self, lab: Lab, folder: Path, library: Path) -> None:
        self.lab, self.library = lab, library
        self.page = Page(folder / "page", library)
        self.index, self.other = self.page.allocate(GATED), self.page.allocate("ours")
        for index in (self.index, self.other):
            self.page.set_ports(index, [(TOPIC, OUTPUT)])
            self.page.ports(index)[0].gate = OPEN
        self.slot: SharedSlot | None = None
        self.task: asyncio.Task[None] | None = None
        self.hangs = False
        self.written: list[float] = []
        self.skipped: list[float] = []

    def share(self, holder: int, *, rate: float | None = 1 / PERIOD) -> None:
        """One baton for both, which ``holder`` has."""
        baton = self.page.new_baton(holder)
        for index in (self.index, self.other):
            share_baton(self.page, [(self.page.ports(index)[0], rate)], baton)
        self.baton = baton

    def place_of(self, index: int, other: int, *, timed: bool = False) -> SharedSlotPlace:
        return SharedSlotPlace(
            page=str(self.page.path),
            library=str(self.library),
            baton=self.baton,
            index=index,
            other=other,
            timed=timed,
        )

    async def start(self) -> None:
        self.slot = SharedSlot(self.place_of(self.index, self.other))
        self.task = asyncio.get_running_loop().create_task(self.write())

    async def write(self) -> None:
        while True:
            if self.slot is not None and not self.hangs:
                passes = self.slot.begin(0)
                (self.written if passes else self.skipped).append(self.now())
                if passes:
                    await self.lab.received("sink")  # a publication takes some turns
                    self.slot.end()
            await self.lab.sleep(PERIOD)

    def die(self, index: int) -> None:
        """Have the process of a node be another one, of which no lock is seen."""
        self.page.layout.nodes[index].pid = 1
        if index == self.index:
            self.hangs = True

    def now(self) -> float:
        return self.lab.backend.clock.steady()

    def name(self) -> None:
        """What the agent of the node does when it is the new side."""
        self.page.step(self.baton, BatonStep.NAME_SUCCESSOR, self.other, self.index)

    def holder(self) -> int:
        return self.page.word(self.baton).holder - 1


def scene(
    folder: Path, library: Path, main: Callable[[Lab, Gated], Awaitable[None]], old: str, **talker: Any
) -> list[str]:
    """Run ``main`` with a component `ours` and a node with a gate, of which ``old`` publishes; what was heard."""
    simulator = Simulator()
    heard: list[str] = []

    async def opened() -> None:
        async with Lab(simulator, folder) as lab:
            gated = Gated(lab, folder, library)
            await lab.start("sink", puppets.sink())
            await lab.attach("sink", "in", TOPIC)
            await lab.mode("sink", "hear", "normal")
            await lab.start("ours", puppets.talker(rate=1 / PERIOD, **talker))
            await lab.attach("ours", "out", TOPIC, peers=1, gate="open" if old == "ours" else "closed")
            await lab.mode("ours", "talk", "normal")
            gated.share(gated.other if old == "ours" else gated.index)
            await gated.start()
            await lab.sleep(0.52)  # another phase
            try:
                await main(lab, gated)
                heard.extend(await lab.received("sink"))
            finally:
                if gated.task is not None:
                    gated.task.cancel()

    simulator.run(opened())
    return heard


async def cut(lab: Lab, gated: Gated, op: str, resume_after: float = 1.0) -> None:
    place = gated.place_of(gated.other, gated.index)
    fields = {name: getattr(place, name) for name in place.__struct_fields__}
    more = {} if op == "cut_out" else {"peer": GATED, "address": ""}
    await lab.change("ours", op, cut="cut", swaps=SWAPS, at=0, resume_after=resume_after, shared_slot=fields, **more)


async def outcome(lab: Lab, timeout: float = 30.0) -> str:
    return str((await lab.read("ours", "await_cut", cut="cut", timeout=timeout))["outcome"])


async def gate(lab: Lab) -> str:
    return str((await lab.port("ours", "out", TOPIC))["gate"])


def silences(times: list[float]) -> float:
    return max((later - earlier for earlier, later in pairwise(times)), default=0.0)


def test_a_component_takes_over(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        assert await gate(lab) == "closed"
        await cut(lab, gated, "cut_in")
        assert await outcome(lab) == "done"
        taken = gated.now()
        assert (gated.holder(), await gate(lab)) == (gated.other, "open")
        assert taken - gated.written[-1] <= PERIOD + 0.01
        await lab.sleep(1.0)
        assert gated.written[-1] < taken  # from then on, nothing of the old side
        count = (await lab.port("ours", "out", TOPIC))["count"]
        assert count >= 18
        gated.page.step(gated.baton, BatonStep.SETTLE, gated.other)  # as the old side's agent does when it is detached
        await lab.sleep(0.2)
        assert not gated.page.layout.nodes[gated.other].used  # its slot is free
        await lab.sleep(0.2)
        assert (await lab.port("ours", "out", TOPIC))["count"] > count

    scene(tmp_path, gate_library, main, old=GATED)


def test_a_component_hands_over(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        await cut(lab, gated, "cut_out")
        await lab.sleep(0.3)
        assert (await gate(lab), gated.written) == ("open", [])  # nothing has changed before a successor is named
        gated.name()
        assert await outcome(lab) == "done"
        assert (gated.holder(), await gate(lab)) == (gated.index, "closed")
        last = (await lab.read("ours", "await_cut", cut="cut", timeout=1.0))["last"][f"out {TOPIC}"]
        assert last["number"] == (await lab.port("ours", "out", TOPIC))["count"]
        silent = gated.written[0] - (last["source"] - 10**18) / 1e9  # by the simulator's clock of ROS
        assert 0 <= silent <= PERIOD + 0.01
        await lab.change("ours", "detach", port="out", topic=TOPIC)
        await lab.sleep(0.2)
        word = gated.page.word(gated.baton)
        assert (word.predecessor, gated.page.layout.nodes[gated.other].used) == (0, 0)
        assert silences(gated.written) < 1.5 * PERIOD

    scene(tmp_path, gate_library, main, old="ours")


def test_the_component_dies_after_it_has_taken_over(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        await cut(lab, gated, "cut_in")
        assert await outcome(lab) == "done"
        gated.die(gated.other)
        await lab.sleep(2.1 * PERIOD)
        assert gated.holder() == gated.index
        assert silences(gated.written) <= 4 * PERIOD  # its own slots: at most two without a message of either

    scene(tmp_path, gate_library, main, old=GATED)


@pytest.mark.parametrize("mode", [{"sleep": 100.0, "at_call": 40}, {"raise": "oh", "at_call": 40}], ids=str)
def test_the_component_hangs_or_raises_before_it_takes_over(
    tmp_path: Path, gate_library: Path, mode: dict[str, Any]
) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        gated.hangs = True
        await cut(lab, gated, "cut_in", resume_after=0.5)
        await lab.sleep(3.0)
        gated.hangs = False  # it offers the baton only now
        written = len(gated.written)
        await lab.sleep(1.0)
        assert silences(gated.written[written:]) <= 2 * PERIOD + 0.01
        assert gated.holder() == gated.index

    scene(tmp_path, gate_library, main, old=GATED, mode=mode)


def test_the_manager_dies_before_it_names_the_node(tmp_path: Path, gate_library: Path) -> None:
    """The component goes on, and takes part in no hand-over any more."""

    async def main(lab: Lab, gated: Gated) -> None:
        await cut(lab, gated, "cut_out", resume_after=0.2)
        before = (await lab.port("ours", "out", TOPIC))["count"]
        assert await outcome(lab) == "resumed"
        assert (await gate(lab), (await lab.port("ours", "out", TOPIC))["gated"]) == ("open", 0)
        assert (await lab.port("ours", "out", TOPIC))["count"] > before + 90
        gated.name()
        assert gated.page.word(gated.baton).successor == 0
        await cut_again(lab, gated)

    scene(tmp_path, gate_library, main, old="ours")


async def cut_again(lab: Lab, gated: Gated) -> None:
    """A later hand-over, with another slot."""
    gated.other = gated.page.allocate("ours")
    gated.page.set_ports(gated.other, [(TOPIC, OUTPUT)])
    gated.page.ports(gated.other)[0].gate = OPEN
    gated.share(gated.other)
    place = gated.place_of(gated.other, gated.index)
    fields = {name: getattr(place, name) for name in place.__struct_fields__}
    await lab.change("ours", "cut_out", cut="again", swaps=SWAPS, at=0, resume_after=1.0, shared_slot=fields)
    gated.name()
    assert (await lab.read("ours", "await_cut", cut="again", timeout=5.0))["outcome"] == "done"


def test_the_node_hangs_after_it_was_named(tmp_path: Path, gate_library: Path) -> None:
    """The component goes on; when the offer has ended, for good."""

    async def main(lab: Lab, gated: Gated) -> None:
        gated.hangs = True
        await cut(lab, gated, "cut_out", resume_after=0.2)
        gated.name()
        assert await outcome(lab) == "resumed"
        link = await lab.port("ours", "out", TOPIC)
        assert (link["gate"], link["gated"]) == ("open", 0)
        gated.hangs = False
        await lab.sleep(0.5)
        assert gated.written == []

    scene(tmp_path, gate_library, main, old="ours")


def test_the_node_dies_after_it_has_taken_over(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        await cut(lab, gated, "cut_out")
        gated.name()
        assert await outcome(lab) == "done"
        before = (await lab.port("ours", "out", TOPIC))["count"]
        gated.die(gated.index)
        await lab.sleep(0.5)
        link = await lab.port("ours", "out", TOPIC)
        assert (link["gate"], link["count"] - before >= 8) == ("open", True)

    scene(tmp_path, gate_library, main, old="ours")


def test_the_node_dies_before_it_lays_the_baton_down(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        gated.die(gated.index)
        await cut(lab, gated, "cut_in")
        assert await outcome(lab) == "done"
        assert (await gate(lab), gated.holder()) == ("open", gated.other)

    scene(tmp_path, gate_library, main, old=GATED)


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_hand_over_to_a_component_is_cancelled(tmp_path: Path, gate_library: Path, when: str) -> None:
    """Before it has the baton, or after: the node has it again, and the component is behind its gate."""

    async def main(lab: Lab, gated: Gated) -> None:
        gated.hangs = when == "before"
        await cut(lab, gated, "cut_in")
        if when == "after":
            assert await outcome(lab) == "done"
        gated.hangs = False
        await lab.change("ours", "cancel_cut", cut="cut")
        assert (await gate(lab), gated.holder()) == ("closed", gated.index)
        assert gated.page.word(gated.baton).successor == 0
        written = len(gated.written)
        await lab.sleep(0.5)
        assert len(gated.written) >= written + 9

    scene(tmp_path, gate_library, main, old=GATED)


def test_a_hand_over_of_a_component_is_cancelled(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        await cut(lab, gated, "cut_out")
        gated.name()
        assert await outcome(lab) == "done"
        words = await lab.refusal("ours", "cancel_cut", cut="cut")
        assert "can still write" in words
        gated.page.step(gated.baton, BatonStep.FENCE, gated.index)  # as the agent of the new side does
        assert gated.page.word(gated.baton).writers == 0
        gated.page.step(gated.baton, BatonStep.GIVE, gated.other)
        await lab.change("ours", "cancel_cut", cut="cut")
        assert await gate(lab) == "open"
        count = (await lab.port("ours", "out", TOPIC))["count"]
        await lab.sleep(0.5)
        assert (await lab.port("ours", "out", TOPIC))["count"] >= count + 9

    scene(tmp_path, gate_library, main, old="ours")


def test_a_node_that_is_fenced_is_taken_over_by_the_manager(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        gated.hangs = True
        await cut(lab, gated, "cut_in")
        await lab.sleep(0.3)
        gated.page.step(gated.baton, BatonStep.FENCE, gated.index)
        assert await outcome(lab) == "cancelled"
        assert gated.page.word(gated.baton).state is BatonState.FENCED
        await lab.change("ours", "gate", port="out", topic=TOPIC, gate="open")
        gated.hangs = False
        await lab.sleep(0.3)
        assert await gate(lab) == "open"
        assert gated.written[-1] < gated.skipped[-1]

    scene(tmp_path, gate_library, main, old=GATED)


def test_a_page_that_cannot_be_used_is_refused(tmp_path: Path, gate_library: Path) -> None:
    async def main(lab: Lab, gated: Gated) -> None:
        words = {"page": str(tmp_path / "elsewhere"), "library": str(gate_library)}
        for name, text in (("page", "page of the gates"), ("library", "library of the gate")):
            place = {"baton": 1, "index": 1, "other": 0, "timed": False, **words}
            place["library"] = str(gate_library) if name == "page" else str(tmp_path / "page")
            fields = {"cut": "cut", "swaps": SWAPS, "at": 0, "resume_after": 1.0, "shared_slot": place}
            assert text in await lab.refusal("ours", "cut_out", **fields)
        assert await gate(lab) == "open"

    scene(tmp_path, gate_library, main, old="ours")
