"""Prolonged silence: of a component, of an output, of an input; in the status, the events, and a change's outcome."""

from __future__ import annotations

import asyncio
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from midstride.backends.simulator import Simulator
from midstride.model.component import PortRef
from midstride.runtime.manager import Manager
from midstride.runtime.watch.silence import PORT_SILENCE, SILENT_PERIODS, SilenceMonitor
from midstride.wire.state import LinkState, MeasuredResponses
from tests.model.build import work
from tests.runtime.scripted import Bench, bench, reported, talking
from tests.runtime.systems import managed, replace


class Reports:
    """What the two components of the talker's example report, twice a second; the test says the counts."""

    def __init__(self, b: Bench) -> None:
        self.b = b
        self.monitor = SilenceMonitor(b.client.life, b.clock, b.events)
        self.counts = {"talker": 0, "listener": 0}
        self.gate: Any = "open"
        self.changed: dict[str, Any] = {}
        self.responses: MeasuredResponses | None = None  # of a server, if the port is one

    async def half_seconds(self, count: int, *, talker: int = 5, listener: int = 5, silent: str | None = None) -> None:
        """``talker`` messages are published and ``listener`` received in each."""
        for _ in range(count):
            await asyncio.sleep(0.5)
            self.counts["talker"] += talker
            self.counts["listener"] += listener
            for name, port, gate in (("talker", "out", self.gate), ("listener", "in", None)):
                if name != silent:
                    self.report(name, port, gate)

    def report(self, name: str, port: str, gate: Any) -> None:
        state = reported(self.b.configuration.instances[name], self.b.configuration)
        functionalities = {
            key: structs.replace(each, since=self.b.clock.steady()) for key, each in state.functionalities.items()
        }
        links = {port: {"/chatter": LinkState(gate=gate, count=self.counts[name], responses=self.responses)}}
        state = structs.replace(state, ports=links, functionalities=functionalities, **self.changed)
        self.b.client.states[name] = state
        self.monitor.on_report(state, self.b.configuration)

    def kinds(self) -> list[tuple[str, str]]:
        return [(fault.kind, fault.port or fault.instance) for fault in self.monitor.faults(self.b.configuration)]


def reporting(path: Path, body: Any) -> None:
    async def main(b: Bench) -> None:
        await body(Reports(b))

    bench(talking(), path, main)


def test_messages_that_flow_are_no_fault(tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        await r.half_seconds(40)
        assert r.kinds() == [] and r.b.words() == []

    reporting(tmp_path, body)


def test_an_input_that_receives_none_of_what_is_published_is_a_fault_until_it_does(tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        await r.half_seconds(4)
        await r.half_seconds(8, listener=0)
        assert r.kinds() == []  # published for 3 s, but the reports of the two are up to half a second apart
        await r.half_seconds(2, listener=0)
        assert r.kinds() == [("not_receiving", "listener.in")]
        [fault] = r.monitor.faults(r.b.configuration)
        assert fault.seconds == pytest.approx(4.0), "since the report of the first message that it has not received"
        await r.half_seconds(2, listener=0)
        assert r.b.words("silence") == ["listener.in receives nothing of what is published on /chatter"]
        await r.half_seconds(3)
        assert r.kinds() == []
        assert r.b.words("silence_ended") == ["listener.in receives messages on /chatter again"]

    reporting(tmp_path, body)


def test_a_single_lost_message_on_a_slow_topic_is_no_fault(tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        await r.half_seconds(4, talker=0, listener=0)
        await r.half_seconds(1, talker=1, listener=0)
        await r.half_seconds(20, talker=0, listener=0)
        assert ("not_receiving", "listener.in") not in r.kinds()

    reporting(tmp_path, body)


def test_an_output_that_publishes_nothing_although_its_mode_guarantees_a_rate_is_a_fault(tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        await r.half_seconds(4)
        await r.half_seconds(6, talker=0, listener=0)
        assert r.kinds() == []
        await r.half_seconds(1, talker=0, listener=0)
        assert r.kinds() == [("not_publishing", "talker.out")]
        [fault] = r.monitor.faults(r.b.configuration)
        assert fault.seconds == pytest.approx(3.5) and fault.topic == "/chatter"
        assert fault.words == "talker.out publishes nothing on /chatter, although mode normal guarantees 10 Hz"
        await r.half_seconds(2, talker=0, listener=0)
        await r.half_seconds(3)
        assert r.b.words("silence_ended") == ["talker.out publishes on /chatter again"]

    assert PORT_SILENCE > SILENT_PERIODS / 10
    reporting(tmp_path, body)


def test_a_server_that_breaks_its_bound_is_a_fault_until_it_does_not(tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        r.responses = MeasuredResponses(within=0.05, tolerated=5.0, silent=4.0)
        await r.half_seconds(4, talker=0, listener=0)
        assert r.kinds() == []
        r.responses = structs.replace(r.responses, silent=5.5, broken="has not answered a request")
        await r.half_seconds(2, talker=0, listener=0)
        r.responses = structs.replace(r.responses, silent=6.5)
        await r.half_seconds(2, talker=0, listener=0)
        assert r.kinds() == [("not_responding", "talker.out")]
        [fault] = r.monitor.faults(r.b.configuration)
        assert (fault.seconds, fault.topic) == (6.5, "/chatter")
        words = "talker.out has not answered a request on /chatter, although 50 ms are promised"
        assert r.b.words("silence") == [words]
        r.responses = structs.replace(r.responses, silent=0.0, broken=None)
        await r.half_seconds(3)
        assert r.b.words("silence_ended") == ["talker.out answers requests on /chatter in time again"]

    reporting(tmp_path, body)


@pytest.mark.parametrize("how", ["lowered", "closed", "detached"])
def test_an_output_of_which_nothing_is_expected_any_more_is_not_said_to_publish_again(how: str, tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        await r.half_seconds(4)
        await r.half_seconds(8, talker=0, listener=0)
        assert r.kinds() == [("not_publishing", "talker.out")]
        if how == "lowered":  # as what a hung component feeds is, before the component is replaced
            r.b.configuration = r.b.configuration.with_modes({work("talker"): 1})
        elif how == "closed":
            r.gate = "closed"
        else:
            r.b.configuration = r.b.configuration.without_attachment(PortRef("talker", "out"), "/chatter")
        await r.half_seconds(4, talker=0, listener=0)
        assert r.kinds() == [] and r.b.words("silence_ended") == []

    reporting(tmp_path, body)


@pytest.mark.parametrize("why", ["gate", "simulated_time", "mode", "lazy"])
def test_an_output_that_need_not_publish_is_no_fault(why: str, tmp_path: Path) -> None:
    async def body(r: Reports) -> None:
        if why == "gate":
            r.gate = "closed"
        elif why == "simulated_time":
            r.changed |= {"simulated_time": True, "clock_speed": 0.0}  # it stands still
        elif why == "lazy":  # and nothing subscribes to it
            talker = r.b.configuration.instances["talker"]
            lazy = changed(talker, component=changed(talker.component, lazy=frozenset({"out"})))
            r.b.configuration = r.b.configuration.without_attachment(PortRef("listener", "in"), "/chatter")
            r.b.configuration = changed(r.b.configuration, instances=r.b.configuration.instances.set("talker", lazy))
        else:
            r.b.configuration = r.b.configuration.with_modes({work("talker"): 1})
        await r.half_seconds(30, talker=0, listener=0)
        assert r.kinds() == []

    reporting(tmp_path, body)


@pytest.mark.parametrize(("speed", "half_seconds"), [(10.0, 7), (1.0, 7), (0.5, 13), (0.1, 61)])
def test_in_simulated_time_an_output_may_be_silent_for_as_long_on_its_clock(
    speed: float, half_seconds: int, tmp_path: Path
) -> None:
    """Never for less than 3 s of real time: components report twice a second."""

    async def body(r: Reports) -> None:
        r.changed |= {"simulated_time": True, "clock_speed": speed}
        await r.half_seconds(4)
        await r.half_seconds(half_seconds - 1, talker=0, listener=0)
        assert r.kinds() == []
        await r.half_seconds(1, talker=0, listener=0)
        assert r.kinds() == [("not_publishing", "talker.out")]

    reporting(tmp_path, body)


def test_what_happened_while_a_component_was_stopped_is_not_judged(tmp_path: Path) -> None:
    """After SIGCONT its counts are those of before, and it has had no time to receive."""

    async def body(r: Reports) -> None:
        await r.half_seconds(4)
        await r.half_seconds(20, listener=0, silent="listener")
        await r.half_seconds(1, listener=0)
        assert r.kinds() == []

    reporting(tmp_path, body)


def test_a_manager_that_was_stopped_does_not_take_its_components_for_silent(tmp_path: Path) -> None:
    """It reads what they have reported meanwhile one after another."""

    async def body(r: Reports) -> None:
        await r.half_seconds(6)
        await asyncio.sleep(10.0)
        r.b.client.states.clear()
        r.report("talker", "out", "open")
        assert r.kinds() == [("not_answering", "listener")], "that is still to be read"
        r.report("listener", "in", None)
        await r.half_seconds(6)
        assert r.b.words() == []

    reporting(tmp_path, body)


def test_what_has_been_removed_is_forgotten(tmp_path: Path) -> None:
    """A system whose instances come and go for months does not grow."""

    async def body(r: Reports) -> None:
        await r.half_seconds(4)
        r.b.configuration = r.b.configuration.without_instance("talker")
        await r.half_seconds(4, silent="talker")
        assert r.monitor._reports.keys() == {"listener"}
        assert [port.instance for links in r.monitor._links.values() for port in links] == ["listener"]

    reporting(tmp_path, body)


# -- on a running system -------------------------------------------------------------------------------


def test_a_component_that_does_not_answer_is_a_fault(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        assert (await manager.status()).valid
        simulator.faults.freeze("listener", 5.0)
        await asyncio.sleep(4)
        status = await manager.status()
        assert [(fault.kind, fault.instance) for fault in status.silences] == [("not_answering", "listener")]
        assert not status.valid
        await asyncio.sleep(3)
        assert (await manager.status()).valid
        words = [event.words for event in manager.log() if event.kind in ("silence", "silence_ended")]
        assert words == ["listener does not answer", "listener answers again"]

    managed("talker", tmp_path, body)


def test_a_component_that_is_being_ended_is_not_missed(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        changing = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        shown = set()
        while not changing.done():
            status = await manager.status()
            assert status.silences == []
            shown |= {(row.name, row.reachable) for row in status.instances if row.ending}
            await asyncio.sleep(0.001)
        assert ("talker", False) in shown

    managed("talker", tmp_path, body)


def test_of_a_component_that_has_exited_it_is_not_said_that_it_does_not_answer(tmp_path: Path) -> None:
    """During a change it stays in the model until the change has ended."""

    async def body(r: Reports) -> None:
        await r.half_seconds(4)
        del r.b.client.states["listener"]
        assert r.kinds() == [("not_answering", "listener")]
        r.b.crash("listener")
        assert r.kinds() == []

    reporting(tmp_path, body)


def test_a_subscriber_whose_middleware_discovers_nothing_any_more_is_not_blinded(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.stop_discovery("listener")
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert outcome.outcome == "rolled_back"
        assert "listener.in has not found talker_2.out on /chatter" in str(outcome.because)
        assert outcome.silences == [] and (await manager.status()).valid

    managed("talker", tmp_path, body)


def test_a_subscriber_that_receives_nothing_after_a_change_is_in_its_outcome(tmp_path: Path) -> None:
    """With a strategy that hands nothing over, the old publisher is gone before the new one is there."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.stop_discovery("listener")
        outcome = await manager.change(replace("talker", "NewTalker", "paper"))
        assert outcome.outcome == "done"
        assert [(fault.kind, fault.port) for fault in outcome.silences] == [("not_receiving", "listener.in")]
        await asyncio.sleep(6)
        status = await manager.status()
        assert [(fault.kind, fault.port) for fault in status.silences] == [("not_receiving", "listener.in")]
        assert not status.valid

    managed("talker", tmp_path, body)
