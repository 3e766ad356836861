"""Nodes without the API in virtual time: what plan, report and status say, beside what an outside recorder has seen."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from midstride.foreign.graph_check import GraphEndpoint
from midstride.foreign.lifecycle_transitions import INACTIVE
from midstride.foreign.replaced_node import lacks
from midstride.model.component import StopTimes
from midstride.model.contract import QoS
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Handle, Launch, RemainingProcess
from midstride.runtime.manager import Manager
from midstride.verdicts.assessment import Assessments
from midstride.verdicts.conditions import EXIT_STATUS
from tests.foreign import simulated
from tests.foreign.chat import chat
from tests.foreign.simulated import SimulatedNode, SimulatedRos

CHAT = chat("lifecycle", talker='parameters { word = "hello" }')
REPLACE = PlanRequest(replace=(("talker", "Other"),))
DRIVER = """system robot
component Driver { run "python3 driver.py" gate none }
node driver : Driver
"""
RESTART = PlanRequest(restart=("driver",))


class OutsideRecorder:
    """Looks every millisecond whether a talker is active that is not hung, and keeps the longest time without one."""

    def __init__(self, simulator: SimulatedRos) -> None:
        self.longest = 0.0
        self._simulator = simulator
        self._task = asyncio.ensure_future(self._look())

    async def _look(self) -> None:
        loop = asyncio.get_running_loop()
        last = loop.time()
        while True:
            if any(name.startswith("talker") for name in self._simulator.active()):
                last = loop.time()
            self.longest = max(self.longest, loop.time() - last)
            await asyncio.sleep(0.001)

    def stop(self) -> float:
        self._task.cancel()
        return self.longest


def said(found: Assessments | None) -> Assessments:
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("behaviour", "outcome"),
    [
        ({}, "done"),
        ({"refuses": {"activate"}}, "rolled_back"),
        ({"hangs": {"activate"}}, "rolled_back"),
        ({"slow": {"activate": 8.0}}, "rolled_back"),
    ],
)
def test_a_lifecycle_node_is_silent_for_as_long_as_the_report_says(
    tmp_path: Path, behaviour: dict[str, Any], outcome: str
) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        plan = PlanPreview.of(await manager.plan(REPLACE)).continuity
        assert plan and plan.verdict == "lost" and "talker_2 is active, 10 s at the longest" in plan.found[0].words
        assert plan.found[0].words.endswith("if that fails, until talker is active again, 18 s at the longest")
        recorder = OutsideRecorder(simulator)
        report = await manager.change(REPLACE)
        heard = recorder.stop()
        found = said(report.continuity)
        assert (report.outcome, found.verdict) == (outcome, "lost")
        assert heard < (10.0 if outcome == "done" else 18.0)
        (silence,) = (each for each in found.found if each.subject == "/chat" and each.verdict == "lost")
        assert silence.at_most and "for at most" in silence.words
        # While the old node is being deactivated, which takes 20 ms here, it may write or not.
        assert silence.seconds is not None and heard > 0.02 and heard <= silence.seconds < heard + 0.03
        history = await manager.history(1)
        assert history.changes[-1].continuity == found
        assert [event for event in manager.log() if event.kind == "outcome"][-1].words.endswith(silence.words)

    simulated.managed(tmp_path, CHAT, body, {"Other": behaviour})


@pytest.mark.parametrize("at_once", [False, True])
def test_a_lifecycle_node_that_is_degraded_is_silent_for_at_most_as_long_as_the_report_says(
    tmp_path: Path, at_once: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It falls silent when it is asked to become inactive, or only when it is."""
    transition = SimulatedNode.transition

    async def silent_at_once(self: SimulatedNode, name: str, state: str, timeout: float) -> bool:
        if name == "deactivate":
            self.state = INACTIVE
        return await transition(self, name, state, timeout)

    if at_once:
        monkeypatch.setattr(SimulatedNode, "transition", silent_at_once)

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        recorder = OutsideRecorder(simulator)
        report = await manager.change(PlanRequest(replace=(("talker", "Other"),), strategy="paper"))
        heard = recorder.stop()
        assert report.outcome == "done", report.because
        (lost,) = (each for each in said(report.continuity).found if each.subject == "talker.talk")
        assert lost.at_most and lost.seconds is not None and "for at most" in lost.words
        assert heard <= lost.seconds < heard + (0.1 if at_once else 2.1)
        assert (heard > 2.0) == at_once

    simulated.managed(tmp_path, CHAT, body, {"Talker": {"slow": {"deactivate": 2.0}}})


def test_a_lifecycle_node_that_hangs_makes_the_system_degraded_and_no_report_calls_it_kept(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["talker"].hung = True
        await asyncio.sleep(10)
        condition = (await manager.status()).condition
        assert condition.state == "degraded"
        assert condition.headline.startswith(
            "degraded, all 2 nodes run: talker does not answer the requests to its lifecycle (for "
        )
        found = said((await manager.change(PlanRequest(restart=("listener",)))).continuity)
        (hung,) = (each for each in found.found if each.subject == "talker")
        assert (hung.verdict, hung.lasting) == ("lost", False) and hung.words.endswith(", as before the change")
        simulator.nodes["talker"].hung = False
        await asyncio.sleep(5)
        assert (await manager.status()).condition.state == "up"

    simulated.managed(tmp_path, CHAT, body)


def test_what_a_node_without_ports_does_is_said_to_be_not_measurable(tmp_path: Path) -> None:
    async def body(manager: Manager, _: SimulatedRos) -> None:
        plan = said(PlanPreview.of(await manager.plan(RESTART)).continuity or None)
        because = "what driver does: no ports are stated"
        assert plan.headline == (
            f"Nothing is known to degrade. Not measurable here: {because}. "
            "The new instance has to be up before the old one is ended; requests of others to services below /driver, "
            "as for its parameters: the node of its replacement is called /driver_2, so none is answered from the end "
            "of driver on."
        )
        (up,) = (await manager.history(1)).changes
        assert said(up.continuity).verdict == "not_measurable", "that it is started is not that it works"
        report = await manager.change(RESTART)
        found = said(report.continuity)
        assert (report.outcome, found.verdict) == ("done", "not_measurable")
        assert found.headline.startswith(
            f"Nothing is known to have fallen below its level. Not measurable here: {because}."
        )
        assert "It was never down: both instances ran for " in found.headline
        condition = (await manager.status()).condition
        assert condition.headline == "up, its node runs; not measurable here: what driver does (no ports are stated)"

    simulated.managed(tmp_path, DRIVER, body)


class Broken(SimulatedRos):
    """The program of the second instance ends ``after`` so many seconds."""

    after = 0.0

    async def start(self, launch: Launch) -> Handle:
        handle = await super().start(launch)
        if launch.instance == "driver_2":
            asyncio.get_running_loop().call_later(self.after, self.die, "driver_2")
        return handle


@pytest.mark.parametrize("after", [0.0, 0.001])
def test_the_old_node_stays_where_the_new_program_ends_at_once(
    tmp_path: Path, after: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated, "SimulatedRos", Broken)
    monkeypatch.setattr(Broken, "after", after)

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        report = await manager.change(RESTART)
        assert report.outcome == "rolled_back" and "driver_2" in str(report.because), report
        assert list(manager.configuration.instances) == ["driver"] == list(simulator.nodes)
        assert said(report.continuity).verdict != "kept"
        assert (await manager.status()).condition.state == "up"

    simulated.managed(tmp_path, DRIVER, body)


class BrokenLate(SimulatedRos):
    """The program of the second instance ends while that of the first is being ended."""

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        if instance == "driver" and "driver_2" in self.nodes:
            self.die("driver_2")
        return await super().end(instance, stop)


def test_a_new_program_that_ends_while_the_old_one_is_ended_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated, "SimulatedRos", BrokenLate)

    async def body(manager: Manager, _: SimulatedRos) -> None:
        found = said((await manager.change(RESTART)).continuity)
        assert (found.verdict, found.lasting) == ("lost", True)
        assert found.headline.startswith("Lost: driver_2; ")

    simulated.managed(tmp_path, DRIVER, body)


def test_a_system_of_which_nothing_runs_is_down(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.die("driver")
        await asyncio.sleep(1)
        condition = (await manager.status()).condition
        assert (condition.state, EXIT_STATUS[condition.state]) == ("down", 1)
        assert condition.headline == "down: none of its 1 node runs" and condition.faults == [
            "driver exited unexpectedly (status 1)"
        ]

    simulated.managed(tmp_path, DRIVER, body)


def test_a_successor_is_up_once_it_has_what_the_old_node_had() -> None:
    def found(*topics: str) -> list[GraphEndpoint]:
        return [GraphEndpoint(True, topic, "std_msgs/msg/String", QoS()) for topic in topics]

    before = found("/said", "/driver/state")
    assert lacks(found("/driver_2/state"), "/driver_2", before, "/driver") == [
        "publishes on /said (std_msgs/msg/String)"
    ]
    assert lacks(found("/said", "/driver/state"), "/driver_2", before, "/driver") != [], "that is the old one's name"
    assert lacks(found("/said", "/driver_2/state", "/more"), "/driver_2", before, "/driver") == []
