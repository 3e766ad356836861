"""Hosts in the simulation: what a link that fails leaves, one thing at a time."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable

import pytest

from midstride.backends.simulator.links import Links
from midstride.backends.simulator.virtual_clock import EPOCH, HostClock, SimulatedClock
from midstride.errors import PlanRefused
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.simulation import scenario
from midstride.simulation.system import System

Act = Callable[[System, Manager], Awaitable[None]]


def spread() -> Specification:
    """The built-in system on three hosts: `lidar` and `driver` on base, `detector` and `guard` on arm."""
    return scenario._built_in("spread")


def run(act: Act) -> None:
    """Bring the system up, and have ``act`` do something to it; no invariant may be violated meanwhile."""
    system = System(spread(), [spread()])
    violated: list[str] = []
    moved = ("planner", "lidar")
    system.invariants.begin(lambda: 1e9, lambda: 1e9, bool, bool, violated.append, moved=moved)

    async def main() -> None:
        manager = system.new_manager()
        await manager.up()
        await act(system, manager)

    try:
        system.run(main())
        assert violated == []
    finally:
        system.close()


def cut(system: System, host: str, seconds: float) -> None:
    for line in (("memory", host), (host, "memory")):
        system.platform.network.links.cut(*line, seconds)


def notes(manager: Manager) -> list[str]:
    return [event.words for event in manager.log() if event.kind in ("note", "host", "exited")]


def test_a_host_that_cannot_be_reached_is_no_crash_and_its_nodes_are_as_they_were_once_it_is_back() -> None:
    async def act(system: System, manager: Manager) -> None:
        before = {process.instance: process.pid for process in system.platform.stand_ins()}
        cut(system, "base", 30.0)
        await asyncio.sleep(25.0)
        assert any("host base cannot be reached" in each for each in notes(manager))
        assert not manager.system.crashes and not any("exited" in each for each in notes(manager))
        assert {process.instance: process.pid for process in system.platform.stand_ins()} == before
        await asyncio.sleep(20.0)
        assert any("host base is reached again" in each for each in notes(manager))
        assert {process.instance: process.pid for process in system.platform.stand_ins()} == before
        assert (await manager.change(PlanRequest(restart=("lidar",)), brief=True)).outcome == "done"

    run(act)


def test_a_plan_says_of_which_nodes_nothing_is_known() -> None:
    async def act(system: System, manager: Manager) -> None:
        assert (await manager.plan(PlanRequest(to=manager.specification))).remarks == ()
        cut(system, "arm", 15.0)
        await asyncio.sleep(8.0)
        plan = await manager.plan(PlanRequest(to=manager.specification))
        words = "nothing is known of detector, guard now: host arm cannot be reached: its connection is silent"
        assert words in plan.remarks
        await asyncio.sleep(20.0)
        cut(system, "base", 15.0)
        await asyncio.sleep(8.0)
        with pytest.raises(PlanRefused, match=r"not valid.*; nothing is known of driver, lidar now: host base cannot"):
            await manager.plan(PlanRequest(to=manager.specification))

    run(act)


def test_a_crash_behind_a_cut_is_known_once_the_link_is_back() -> None:
    async def act(system: System, manager: Manager) -> None:
        cut(system, "base", 10.0)
        system.platform.faults.kill("lidar")
        await asyncio.sleep(9.0)
        assert "lidar" in manager.configuration.instances
        await asyncio.sleep(15.0)
        assert list(manager.system.crashes) == ["lidar"]

    run(act)


def test_what_could_not_be_ended_on_a_host_is_ended_once_that_is_reached_again() -> None:
    async def act(system: System, manager: Manager) -> None:
        async def before_request(instance: str, op: str) -> None:
            if instance == "lidar_2":
                system.hosts["base"].kill()

        system.platform.control.before_request = before_request
        outcome = await manager.change(PlanRequest(restart=("lidar",)), brief=True)
        assert outcome.outcome == "failed" and "whether lidar_2 runs there is not known" in str(outcome.because)
        system.platform.control.before_request = None
        await asyncio.sleep(5.0)
        assert "lidar_2" not in system.platform.processes and "lidar_2" not in system.recorded()
        assert "lidar_2 could not be terminated before, and has been now" in notes(manager)
        assert (await manager.change(PlanRequest(restart=("lidar",)), brief=True)).outcome == "done"

    run(act)


def test_a_roll_back_attaches_nothing_beside_what_may_publish_on_a_host_that_cannot_be_reached() -> None:
    """The new instance has been attached there, and its reply was lost."""

    async def act(system: System, manager: Manager) -> None:
        async def before_request(instance: str, op: str) -> None:
            process = system.platform.standing(instance)
            if op != "attach" or process is None or process.role != "planner" or process.state is None:
                return
            if process.state.ports["objects"] and process.state.ports["map"]:
                system.platform.network.links.cut("arm", "memory", 30.0)

        system.platform.control.before_request = before_request
        outcome = await manager.change(PlanRequest(on=(("planner", "arm"),), strategy="paper"), brief=True)
        assert outcome.outcome == "failed"
        assert "planner_2 could not be ended, and may publish there" in str(outcome.because)
        system.platform.control.before_request = None
        await asyncio.sleep(45.0)
        done = await manager.change(PlanRequest(to=manager.specification, strategy="paper"), brief=True)
        assert done.outcome == "done", done.because
        assert len([each for each in system.platform.stand_ins() if each.role == "planner"]) == 1

    run(act)


def test_nothing_is_started_elsewhere_while_what_could_not_be_ended_may_run() -> None:
    async def act(system: System, manager: Manager) -> None:
        async def before_request(instance: str, op: str) -> None:
            if instance == "lidar_2":
                cut(system, "base", 30.0)

        system.platform.control.before_request = before_request
        restarted = await manager.change(PlanRequest(restart=("lidar",)), brief=True)
        assert restarted.outcome == "failed"
        system.platform.control.before_request = None
        add = PlanRequest(on=(("lidar", "arm"),), strategy="paper")
        refused = await manager.change(add, brief=True)
        assert refused.outcome == "refused" and "lidar_2 could not be ended, and may run" in str(refused.because)
        await asyncio.sleep(45.0)
        assert (await manager.change(add, brief=True)).outcome == "done"

    run(act)


def test_messages_over_a_line_that_is_cut_are_late_or_lost() -> None:
    async def act(system: System, manager: Manager) -> None:
        links, network = system.platform.network.links, system.platform.network
        (reader,) = [each for each in network.topics["/scan"].readers if each.owner.on == "arm"]
        (writer,) = network.topics["/scan"].writers
        links.cut("base", "arm", 3.0)
        count = writer.number
        seen: list[int] = []
        wake = reader._wake

        def woken() -> None:
            seen.append(1)
            wake()

        reader._wake = woken
        await asyncio.sleep(2.9)
        assert writer.number > count + 20 and not seen
        await asyncio.sleep(0.2)
        assert (len(seen) > 20) == writer.qos.is_reliable

    run(act)


@pytest.mark.parametrize(("ahead", "drift"), [(0.0, 0.0), (3.0, 1e-4), (-2.5, -0.01)])
def test_a_clock_of_a_host_is_ahead_and_drifts_and_its_timers_know(ahead: float, drift: float) -> None:
    loop = asyncio.new_event_loop()
    try:
        base = SimulatedClock()
        base.follow(loop)
        clock = HostClock(base, ahead, drift)
        now = base.steady()
        assert clock.system_now() - EPOCH == pytest.approx((now * (1 + drift) + ahead) * 1e9, abs=2e6)
        later = EPOCH + round((ahead + 100.0 * (1 + drift)) * 1e9)
        assert clock.loop_time(later) - base.loop_time(EPOCH) == pytest.approx(100.0, abs=1e-6)
    finally:
        loop.close()


def test_a_lossy_line_sends_again_and_a_slow_one_is_late() -> None:
    async def body() -> None:
        clock = SimulatedClock()
        clock.follow(asyncio.get_running_loop())
        links = Links(clock, random.Random(0))
        links.slow("a", "b", 0.02)
        links.lose("b", "a", 1.0)
        assert links.loses("b", "a") and not links.loses("a", "b")
        arrived = asyncio.Event()
        begun = clock.steady()
        links.deliver("a", "b", 0.0, arrived.set)
        await arrived.wait()
        assert clock.steady() - begun >= 0.02

    asyncio.run(body())
