"""Systems on several hosts under a manager: carried out on the simulator, refused where the back end has no others."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from dataclasses import replace as changed
from pathlib import Path

import pytest
from immutables import Map
from msgspec import UNSET

from midstride.backends.simulator import Simulator
from midstride.errors import EndUnknown, ManagerError, PlanRefused
from midstride.model.component import StopTimes
from midstride.model.hosts import HostSpec
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Handle, HostLinkState, Launch, RemainingProcess
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import HostStatus
from midstride.runtime.workspace import Workspace
from midstride.wire.clock_offset import ClockOffset
from tests.runtime.systems import EXAMPLES, example, managed, saved

CLOCK = ClockOffset(ahead=-4_000_000, uncertainty=1_000_000, at=0)


class OneHost(Simulator):
    """Starts processes on the host of the manager alone, as on ROS 1."""

    name = "one"
    reaches_hosts = False

    def __init__(self) -> None:
        super().__init__()
        self.launches: list[Launch] = []

    async def start(self, launch: Launch) -> Handle:
        self.launches.append(launch)
        return await super().start(launch)


class Hosts(OneHost):
    """Its hosts are reached unless they are ``lost``."""

    name = "sim"
    reaches_hosts = True

    def __init__(self) -> None:
        super().__init__()
        self.lost: set[str] = set()
        self.unknown = False  # whether a process has ended
        self.tried: list[list[str]] = []  # what was tried again
        self.found: set[str] = set()  # the hosts that the next attempt reaches

    async def start(self, launch: Launch) -> Handle:
        return changed(await super().start(launch), host=launch.host)

    async def try_again(self, hosts: Collection[str]) -> None:
        self.tried.append(sorted(hosts))
        self.lost -= self.found

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        if self.unknown or (instance == "talker" and "arm" in self.lost):
            raise EndUnknown(f"whether {instance} runs is not known")
        return await super().end(instance, stop)

    def host_links(self) -> list[HostLinkState]:
        problem = "is it switched on?"
        return [
            HostLinkState(name, f"robot@{name}", 1000.0, problem if name in self.lost else None, "1.2.3", CLOCK)
            for name in ("arm", "base")
        ]


def on_hosts(**hosts: str) -> Specification:
    """The talker's example with its nodes on these hosts."""
    specification = example("talker")
    declared = Map({name: HostSpec(name, name) for name in ("arm", "base")})
    nodes = specification.nodes
    for role, host in hosts.items():
        nodes = nodes.set(role, changed(nodes[role], host=host))
    return changed(specification, hosts=declared, nodes=nodes)


def test_a_node_is_started_on_its_host_and_moves_without_a_missed_message(tmp_path: Path) -> None:
    platform = Hosts()

    async def body(manager: Manager, _: Simulator) -> None:
        assert {each.instance: each.host for each in platform.launches} == {"talker": "arm", "listener": ""}
        assert {each.name: each.host for each in (await manager.status()).instances} == {
            "talker": "arm",
            "listener": None,
        }
        explained = [await manager.why(each) for each in ("talker.talk", "listener.listen")]
        assert [each.host for each in explained] == ["arm", UNSET]
        outcome = await manager.change(PlanRequest(on=(("talker", "base"),)))
        assert outcome.outcome == "done" and [each.missed for each in outcome.swaps] == [0]
        assert (platform.launches[-1].instance, platform.launches[-1].host) == ("talker_2", "base")
        assert manager.specification.nodes["talker"].host == "base"
        assert manager.configuration.instances["talker_2"].host == "base"
        (known,) = [each.instance for each in saved(Workspace(tmp_path)).instances if each.instance.role == "talker"]
        assert known == manager.configuration.instances["talker_2"]
        back = await manager.change(PlanRequest(on=(("talker", "manager"),)))
        assert back.outcome == "done" and platform.launches[-1].host == ""
        moved = on_hosts(talker="arm", listener="arm")
        outcome = await manager.change(PlanRequest(to=moved))
        assert outcome.outcome == "done"
        assert {each.host for each in manager.configuration.instances.values()} == {"arm"}

    managed("talker", tmp_path, body, platform, on_hosts(talker="arm"))


def test_the_nodes_of_a_host_that_cannot_be_reached_are_unreachable_and_not_crashed(tmp_path: Path) -> None:
    platform = Hosts()

    async def body(manager: Manager, simulator: Simulator) -> None:
        found = await manager.status()
        assert [(each.name, each.connected, each.instances) for each in found.hosts] == [
            ("arm", True, ["talker"]),
            ("base", True, []),
        ]
        assert found.condition.state == "up" and manager.watched.monitor.faults(manager.configuration) == []
        platform.lost = {"arm"}
        assert (await manager.status()).instances[1].unreachable is False  # it has reported just now
        simulator.faults.freeze("talker", 60.0)
        await simulator.clock.sleep(5.0)
        found = await manager.status()
        assert found.hosts[0] == HostStatus(
            name="arm",
            destination="robot@arm",
            connected=False,
            since=1000.0,
            because="is it switched on?",
            version="1.2.3",
            instances=["talker"],
            clock_ahead=-0.004,
            clock_uncertainty=0.001,
        )
        listener, talker = found.instances
        assert (talker.reachable, talker.unreachable, listener.unreachable) == (False, True, False)
        assert talker.deviation == "its host arm cannot be reached"
        assert found.crashed == [] and {each.kind for each in found.silences} == {"unreachable"}
        assert found.condition.faults == ["host arm cannot be reached, so nothing is known of talker"]
        assert "1 of 2 nodes run, and whether 1 more does is not known: host arm" in found.condition.headline
        assert (await manager.why("talker.talk")).remedies == [
            "host arm cannot be reached: is it switched on?; the manager connects again by itself"
        ]
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        assert outcome.outcome == "refused"
        assert outcome.because == (
            "talker cannot be changed now: host arm cannot be reached: is it switched on?; if it is switched off or "
            "destroyed, `midstride dead arm` says so"
        )
        assert platform.tried == [["arm"]]
        assert (await manager.change(PlanRequest(restart=("listener",)))).outcome == "done"
        assert platform.tried == [["arm"]], "it needs no other host"
        assert {each.instance for each in platform.launches} == {"talker", "listener", "listener_2"}

    managed("talker", tmp_path, body, platform, on_hosts(talker="arm"))


def test_a_command_tries_once_more_to_reach_the_host_that_it_needs(tmp_path: Path) -> None:
    platform = Hosts()

    async def body(manager: Manager, _: Simulator) -> None:
        platform.lost = {"arm"}
        platform.found = {"arm"}
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "done"
        assert platform.tried == [["arm"]]

    managed("talker", tmp_path, body, platform, on_hosts(talker="arm"))


def test_down_while_a_host_cannot_be_reached_says_what_to_do_and_what_still_runs(tmp_path: Path) -> None:
    platform = Hosts()

    async def body(manager: Manager, simulator: Simulator) -> None:
        platform.lost = {"arm"}
        simulator.faults.freeze("talker", 60.0)
        await simulator.clock.sleep(5.0)
        with pytest.raises(ManagerError) as refused:
            await manager.down()
        assert str(refused.value) == (
            "talker: whether talker runs is not known; once host arm is reached again, run `midstride down` again; if "
            "it is switched off or destroyed, run `midstride dead arm` before that"
        )
        assert platform.tried == [["arm"]]
        found = (await manager.status()).condition
        assert found.headline.startswith("degraded, 0 of 2 nodes run, and whether 1 more does is not known: ")
        assert found.faults == ["listener does not run", "host arm cannot be reached, so nothing is known of talker"]
        assert [each.instance.name for each in saved(Workspace(tmp_path)).instances] == ["talker"]
        assert (await manager.declare_dead("arm", "ann")).instances == ["talker"]
        await manager.down()
        assert any("talker was on host arm, which is dead" in each.words for each in manager.events.since())

    managed("talker", tmp_path, body, platform, on_hosts(talker="arm"))


def test_what_a_change_has_left_half_done_on_a_host_is_taken_back_once_that_is_possible(
    tmp_path: Path,
) -> None:
    platform = Hosts()

    async def body(manager: Manager, simulator: Simulator) -> None:
        platform.unknown = True
        outcome = await manager.change(PlanRequest(replace=(("talker", "NewTalker"),)))
        assert outcome.outcome == "failed"
        assert {*manager.configuration.instances} == {"talker", "talker_2", "listener"}
        await simulator.clock.sleep(5.0)  # it is tried, in vain
        assert len(manager.configuration.instances) > 2
        platform.unknown = False
        await simulator.clock.sleep(20.0)
        assert {each.component.name for each in manager.configuration.instances.values()} == {"Talker", "Listener"}
        found = await manager.status()
        assert found.valid and found.condition.state == "up"
        assert any("roll back talker failed" in each.words for each in manager.events.since())

    managed("talker", tmp_path, body, platform, on_hosts(talker="arm"))


def test_a_node_whose_move_failed_after_it_had_moved_returns_to_its_host_once_that_is_reached(tmp_path: Path) -> None:
    platform = Hosts()

    async def body(manager: Manager, simulator: Simulator) -> None:
        platform.unknown = True
        outcome = await manager.change(PlanRequest(on=(("talker", "manager"),)))
        assert outcome.outcome == "failed" and "what has been done stays" in str(outcome.because)
        platform.lost.add("arm")
        simulator.faults.kill("talker")
        platform.unknown = False
        await simulator.clock.sleep(20.0)
        assert [each.host for each in manager.configuration.instances_of("talker")] == [""]  # nothing can be done
        platform.lost.clear()
        await simulator.clock.sleep(20.0)
        assert [each.host for each in manager.configuration.instances_of("talker")] == ["arm"]
        found = await manager.status()
        assert found.valid and found.condition.state == "up"

    managed("talker", tmp_path, body, platform, on_hosts(talker="arm"))


def test_nothing_is_started_where_the_back_end_reaches_no_other_host(tmp_path: Path) -> None:
    platform = OneHost()

    async def main() -> None:
        manager = Manager(on_hosts(talker="arm"), platform, Workspace(tmp_path), EXAMPLES / "talker")
        with pytest.raises(ManagerError) as refused:
            await manager.up()
        assert str(refused.value) == (
            "the back end one starts processes on the host of the manager alone, so nothing is started: talker on arm"
        )
        await manager.close()
        assert platform.launches == [] and not list(tmp_path.glob("state.db"))

    platform.run(main())


def test_a_change_to_another_host_is_refused_likewise_and_hosts_without_nodes_are_not(tmp_path: Path) -> None:
    platform = OneHost()

    async def body(manager: Manager, _: Simulator) -> None:
        request = PlanRequest(on=(("talker", "base"),))
        with pytest.raises(PlanRefused, match="so nothing is started: talker on base"):
            await manager.plan(request)
        outcome = await manager.change(request)
        assert outcome.outcome == "refused" and "talker on base" in str(outcome.because)
        assert (await manager.change(PlanRequest(to=on_hosts(listener="arm")))).outcome == "refused"
        assert len(platform.launches) == 2
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "done"
        await asyncio.sleep(0)

    managed("talker", tmp_path, body, platform, on_hosts())
