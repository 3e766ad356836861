"""Intra-process communication, as rclcpp has it: the gate keeps outputs out of it, or it is known that it cannot.

Plain processes; what they are linked with has the functions of rclcpp by its names, as librclcpp exports them.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.foreign.gated_agent import ForeignAgent
from midstride.foreign.gates import PATIENCE, Gates, total
from midstride.foreign.page_layout import OPEN, OUTPUT, Within
from midstride.foreign.record import ForeignRecord
from midstride.model.component import ComponentSpec
from midstride.node.handover.baton import BatonStep
from midstride.wire.sockets import SocketFolder
from tests.foreign.lab import MS, Lab, until

TALKER = ComponentSpec.of("Talker", outputs=("out",), run="talker", gate="preload")


@pytest.fixture(autouse=True)
def within(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_WITHIN", "1")


def prepared(lab: Lab, instance: str = "talker") -> tuple[int, Gates]:
    index = lab.page.allocate(instance)
    gates = Gates(lab.page, index, TALKER)
    gates.prepare({"out": "/chat"})
    return index, gates


def test_an_output_is_kept_out_so_its_gate_holds(lab: Lab) -> None:
    index, gates = prepared(lab)
    lab.run(index, MS, 10**12)
    until(lambda: gates.entry("out").gated > 10, "its gate does not hold it back")
    assert lab.count() == 0, "a subscription of its process got a message past the closed gate"
    assert gates.is_kept_out("out")
    assert not gates.past_the_gate()
    gates.set_gate("out", True)
    until(lambda: lab.count() > 10, "it does not write")
    assert lab.count() <= lab.written_by(index) + 1, "not all of it went through the gate"


def test_it_is_handed_over_as_any_other(lab: Lab) -> None:
    old, own = prepared(lab)
    lab.run(old, MS, 10**12)
    own.set_gate("out", True)
    until(lambda: lab.written_by(old) > 10, "it does not write")
    new, gates = prepared(lab, "talker_2")
    gates.entry("out").baton = own.baton("out")
    gates.set_gate("out", True)
    lab.run(new, MS, 10**12)
    while lab.word(own.baton("out")).holder != new + 1:
        lab.page.step(own.baton("out"), BatonStep.NAME_SUCCESSOR, old, new, at_once=True)
        lab.page.step(own.baton("out"), BatonStep.TAKE, new)
        time.sleep(0.002)
    until(lambda: lab.written_by(new) > 10, "the new one does not write")
    lab.close()
    writers = [writer for writer, _, _ in lab.records()]
    assert writers == sorted(writers), "both were heard"


def test_without_a_port_it_takes_part_and_is_not_said_to_be_handed_over(lab: Lab) -> None:
    index = lab.page.allocate("talker")
    lab.page.set_ports(index, [("/other", OUTPUT)])
    lab.page.have_requests(index, None)
    lab.page.have_unstated(index, PATIENCE, None)
    lab.start(index, "/chat", str(MS), "1000000")
    until(lambda: lab.count() > 10, "it does not write")
    assert set(lab.page.unstated(index)) == {"/chat"}
    assert not Gates(lab.page, index, ComponentSpec.of("Talker")).unstated_topics()


@pytest.mark.parametrize(
    ("readers", "inside", "passed", "written"),
    [("only", 200, 0, 200), ("both", 200, 200, 200), ("untold", 0, 0, 0)],
)
def test_what_goes_within_the_process_is_counted_once(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, readers: str, inside: int, passed: int, written: int
) -> None:
    monkeypatch.setenv("FAKE_WITHIN", readers)
    index = lab.page.allocate("talker")
    Gates(lab.page, index, ComponentSpec.of("Talker", run="talker", gate="preload")).prepare({})
    lab.start(index, "/chat", str(MS // 5), "200")
    until(lambda: lab.count() == 200 + passed, "not all is written")
    port = lab.port(index)
    until(lambda: int(port.written) == written, "not each is counted once")
    assert (int(port.inside), int(port.passed)) == (inside, passed)
    assert port.within == Within.TAKES_PART and total(port) == written
    assert (port.last > 0) == (written > 0)


def test_an_output_that_takes_part_is_a_difference(lab: Lab, tmp_path: Path) -> None:
    """As where librclcpp does not have the function by which a publisher is taken out."""
    index, gates = prepared(lab)
    gates.entry("out").within = 0
    gates.entry("out").gate = OPEN
    lab.start(index, "/chat", str(MS), "1000000")
    until(lambda: lab.count() > 10, "it does not write")
    assert gates.past_the_gate() == ["out"]
    assert gates.entry("out").within == Within.TAKES_PART
    record = ForeignRecord(
        instance="talker_2",
        node="/talker",
        token="",
        uuid="",
        pid=lab.processes[index].pid,
        started=time.time_ns(),
        declaration=NamedComponentForm.of(TALKER),
        index=index,
        topics={"out": "/chat"},
        modes={},
    )

    async def refused() -> str | None:
        agent = ForeignAgent(record, tmp_path, gates, graph=list)
        await agent.open(SocketFolder(tmp_path / "components"))
        try:
            await agent.node.comes_true(lambda: bool(agent.node.differences), 10)
            return "; ".join(agent.node.differences)
        finally:
            await agent.close()

    said = asyncio.run(refused())
    assert said is not None
    assert "output out uses intra-process communication" in said
    assert "use_intra_process_comms(false)" in said
