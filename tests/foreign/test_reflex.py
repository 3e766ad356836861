"""The reflex of a node without Midstride's API, on a page whose processes are simulated by what they would write."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.foreign import gated_agent as agent_module
from midstride.foreign import gated_reflex
from midstride.foreign.gated_agent import ForeignAgent
from midstride.foreign.gated_reflex import broken_assumptions
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode
from midstride.foreign.page import Page
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import FRESH, ReportedStates
from midstride.lang.load import load
from midstride.node.handover.baton import BatonStep
from midstride.runtime.manager_clock import SystemClock
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire import commands
from midstride.wire.sockets import SocketFolder
from midstride.wire.state import ComponentState, GateState, LinkState, Measured
from tests.foreign.full_disk import FullDisk

TEXT = """system drive

topic /scan : std_msgs/msg/String @ 20 Hz
topic /cmd  : std_msgs/msg/String @ 20 Hz

component Lidar {
  run "lidar" gate preload
  output scan
  functionality sense {
    produces scan
    mode normal { guarantee scan : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
}

component Driver {
  run "driver" gate preload
  parameters { speed = 1.0 }
  input  scan : std_msgs/msg/String @ 20 Hz tolerates 199 missed
  output cmd
  functionality drive {
    uses scan
    produces cmd
    mode normal {
      assume scan
      guarantee cmd : std_msgs/msg/String @ 20 Hz
    }
    mode slow {
      parameters { speed = 0.2 }
      guarantee cmd : std_msgs/msg/String @ 20 Hz
    }
    mode degraded { }
  }
}

node lidar  : Lidar  { scan -> /scan }
node driver : Driver { scan <- /scan   cmd -> /cmd }
"""
TOPICS = {"scan": "/scan", "cmd": "/cmd"}


class Robot:
    """A lidar and a driver, attached and in their normal modes."""

    def __init__(self, folder: Path, library: Path) -> None:
        (folder / "drive.stride").write_text(TEXT, encoding="utf-8")
        components = load(folder / "drive.stride").require().components
        self.page = Page(folder / "page", library)
        self.gates = {}
        for name in ("Lidar", "Driver"):
            gates = self.gates[name] = Gates(self.page, self.page.allocate(name), components[name])
            gates.prepare({port: TOPICS[port] for port in components[name].ports()})
            for port in components[name].outputs:
                gates.set_gate(port, True)
        self.wrote(0)
        self.received(0)
        self.record = ForeignRecord(
            instance="driver",
            node="/driver",
            token="a token",
            uuid="driver",
            pid=1,
            started=0,
            declaration=NamedComponentForm.of(components["Driver"]),
            index=self.gates["Driver"].index,
            topics=TOPICS,
            modes={"drive": "normal"},
            links={"scan": "open", "cmd": "open"},
            welcomed=True,
        )
        self.driver = ForeignNode(self.record, folder, self.gates["Driver"], ReportedStates())
        self.driver._since["drive"] -= 3600

    def wrote(self, seconds: float) -> None:
        self.gates["Lidar"].entry("scan").tried = time.monotonic_ns() - int(seconds * 1e9)

    def received(self, seconds: float) -> None:
        self.gates["Driver"].entry("scan").tried = time.monotonic_ns() - int(seconds * 1e9)


@pytest.fixture
def robot(tmp_path: Path, gate_library: Path) -> Robot:
    return Robot(tmp_path, gate_library)


def test_what_relies_on_a_silent_publisher_is_broken_after_the_stated_window(robot: Robot) -> None:
    robot.wrote(9)
    robot.received(9)
    assert broken_assumptions(robot.driver) == {}
    robot.wrote(11)
    robot.received(11)
    mode, because = broken_assumptions(robot.driver)["drive"]
    assert mode == "slow"
    assert because.startswith("the assumption of mode normal broke: input scan received nothing on /scan for 11.")
    assert because.endswith("(20 Hz is assumed; silence is tolerated for 10 s)")
    robot.driver.enter_modes({"drive": "slow"}, "a test")
    robot.driver._since["drive"] -= 3600
    assert broken_assumptions(robot.driver) == {}


def test_a_node_that_takes_no_messages_is_not_judged_while_they_are_written(robot: Robot) -> None:
    robot.received(30)
    assert broken_assumptions(robot.driver) == {}


def test_silence_counts_from_the_entry_to_the_mode(robot: Robot) -> None:
    robot.wrote(30)
    robot.received(30)
    robot.driver.enter_modes({"drive": "normal"}, "a test")
    assert broken_assumptions(robot.driver) == {}


def test_one_that_may_not_publish_is_not_judged(robot: Robot) -> None:
    """What relies on it is up to the change that has closed its gate, or has given its baton to another one."""
    robot.wrote(30)
    robot.received(30)
    lidar = robot.gates["Lidar"]
    lidar.set_gate("scan", False)
    assert broken_assumptions(robot.driver) == {}
    lidar.set_gate("scan", True)
    assert broken_assumptions(robot.driver)
    robot.page.step(lidar.baton("scan"), BatonStep.GIVE, 100)
    assert broken_assumptions(robot.driver) == {}


def report(
    instance: str, topic: str, age: float | None, gate: GateState = "open", simulated: bool = False
) -> ComponentState:
    link = LinkState(gate=gate, count=1, measured=Measured(window=1.0, age=age))
    return ComponentState(
        instance=instance,
        uuid="1",
        pid=1,
        revision=0,
        functionalities={},
        ports={"out": {topic: link}},
        parameters={},
        stopping=0.0,
        simulated_time=simulated,
    )


def test_publishers_that_report_are_judged_as_well(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """As relays do: the topic is silent if none of its publishers writes."""
    writes = ReportedStates()
    robot.driver.others = writes
    robot.gates["Lidar"].set_gate("scan", False)
    robot.received(30)
    writes.note(report("relay", "/scan", 30.0))
    assert "received nothing on /scan for 30" in broken_assumptions(robot.driver)["drive"][1]
    writes.note(report("other", "/scan", 0.1))
    assert broken_assumptions(robot.driver) == {}
    writes.note(report("other", "/scan", 0.1, gate="closed"))
    assert broken_assumptions(robot.driver)
    robot.gates["Lidar"].set_gate("scan", True)
    robot.wrote(1)
    assert broken_assumptions(robot.driver) == {}
    robot.wrote(30)
    assert broken_assumptions(robot.driver)
    robot.gates["Lidar"].set_gate("scan", False)
    for state in (
        report("relay", "/cmd", 30.0),
        report("relay", "/scan", None),
        report("relay", "/scan", 30.0, simulated=True),
    ):
        writes.note(state)
        assert broken_assumptions(robot.driver) == {}
    writes.note(report("relay", "/scan", 30.0))
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + FRESH)  # it has stopped reporting
    assert writes.silence("/scan") is None


def test_on_simulated_time_nothing_is_judged(robot: Robot) -> None:
    robot.wrote(30)
    robot.received(30)
    assert robot.driver.state().ports["scan"]["/scan"].measured is not None
    robot.driver.change_record(stated={"use_sim_time": True})
    assert broken_assumptions(robot.driver) == {}
    assert robot.driver.state().ports["scan"]["/scan"].measured is None  # half as fast where `/clock` is


def test_on_a_full_disk_the_gate_closes_and_the_reflex_goes_on(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gated_reflex, "tolerated_periods", lambda *_: 0.0)
    monkeypatch.setattr(agent_module, "HEARTBEAT", 0.01)
    gates = robot.gates["Driver"]

    async def scenario() -> None:
        for port in ("scan", "cmd"):
            gates.entry(port).endpoints = 1
        agent = ForeignAgent(robot.record, tmp_path, gates)
        node = agent.node
        disk = FullDisk(monkeypatch, "driver.json")
        await agent.open(SocketFolder(tmp_path / "components"))
        try:
            while "drive" not in node.record.fallen:
                await asyncio.sleep(0.005)
            assert node.unwritten == f"{tmp_path / 'driver.json'} cannot be written: No space left on device"
            node.enter_modes({"drive": "degraded"}, "a command")
            assert not gates.entry("cmd").gate
            node.enter_modes({"drive": "normal"}, "a command")  # again
            while "drive" not in node.record.fallen:
                await asyncio.sleep(0.005)
            disk.has_room()
            while ForeignRecord.read(tmp_path, "driver") != node.record:
                await asyncio.sleep(0.005)
        finally:
            await agent.close()

    asyncio.run(asyncio.wait_for(scenario(), 30))


def test_the_agent_enters_the_mode_and_says_why(robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So does the agent of the next manager, until a command enters another mode."""
    monkeypatch.setattr(gated_reflex, "tolerated_periods", lambda *_: 0.0)

    async def scenario() -> None:
        transport = SocketFolder(tmp_path / "components")
        client = ComponentClient(transport, SystemClock(), "a token")
        for port in ("scan", "cmd"):
            robot.gates["Driver"].entry(port).endpoints = 1
        agents = []
        try:
            record: ForeignRecord | None = robot.record
            for _ in range(2):
                assert record is not None
                agents.append(ForeignAgent(record, tmp_path, robot.gates["Driver"]))
                await agents[-1].open(transport)
                await client.registered("driver")
                while (view := (await client.observe("driver")).functionalities["drive"]).mode == "normal":
                    await asyncio.sleep(0.05)
                assert (view.mode, view.reflex) == ("slow", True)
                assert "input scan received nothing" in view.because
                await agents[-1].close()
                client.disconnect("driver")
                record = ForeignRecord.read(tmp_path, "driver")
            agents.append(ForeignAgent(agents[-1].node.record, tmp_path, robot.gates["Driver"]))
            await agents[-1].open(transport)
            await client.registered("driver")
            await client.observe("driver")
            await client.change("driver", commands.ModesCommand(modes={"drive": "degraded"}))
            view = (await client.observe("driver")).functionalities["drive"]
            assert (view.mode, view.reflex) == ("degraded", False)
        finally:
            client.close()
            for agent in agents:
                await agent.close()

    asyncio.run(scenario())
