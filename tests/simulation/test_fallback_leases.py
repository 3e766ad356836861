"""A node with a fallback on another host: when that takes over, what is written meanwhile, and how it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from dataclasses import replace as changed
from itertools import pairwise

import pytest

from midstride.backends.simulator.network import SimulatedWriter
from midstride.errors import ManagerError
from midstride.model.hosts import OWN_HOST
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.restore.fallback_leases import LOOK
from midstride.simulation import scenario
from midstride.simulation.campaign import simulate_many
from midstride.simulation.system import System
from midstride.wire.commands import LEASE_SLACK
from tests.simulation.planted import planted

SECONDS = 8.0
HOSTS = ("memory", "arm", "base")
# How long the plan of a fallback takes here at most (s).
STARTED = 2.0


def spread(role: str = "lidar", host: str = OWN_HOST, seconds: float | None = SECONDS) -> Specification:
    """The built-in system on three hosts with one fallback: `lidar` and `driver` are on base, `detector` on arm."""
    specification = scenario._built_in("spread")
    if seconds is None:
        return specification
    node = specification.nodes[role]
    policy = RespawnPolicy(fallback=node.component, fallback_host=host, lease=seconds)
    return specification.with_node(changed(node, respawn=policy))


@dataclass
class Scene:
    """A system that is up; ``written``: by topic, when which instance wrote there (steady s)."""

    system: System
    manager: Manager
    written: dict[str, list[tuple[float, str]]] = field(default_factory=dict)

    def now(self) -> float:
        return self.system.platform.time.steady()

    def cut(self, host: str, seconds: float) -> None:
        for other in (each for each in HOSTS if each != host):
            for line in ((host, other), (other, host)):
                self.system.platform.network.links.cut(*line, seconds)

    def heard(self, writer: SimulatedWriter) -> None:
        self.written.setdefault(writer.topic, []).append((self.now(), writer.owner.instance))

    def on(self, topic: str, since: float = 0.0) -> list[str]:
        """The instances that have written on ``topic`` since then, in turn."""
        found: list[str] = []
        for at, instance in self.written.get(topic, []):
            if at >= since and found[-1:] != [instance]:
                found.append(instance)
        return found

    def last(self, topic: str, instance: str) -> float:
        return max(at for at, name in self.written[topic] if name == instance)

    def first(self, topic: str, instance: str) -> float:
        return min(at for at, name in self.written[topic] if name == instance)

    def notes(self) -> str:
        return "; ".join(event.words for event in self.manager.log())

    @property
    def running(self) -> list[str]:
        return sorted(process.instance for process in self.system.platform.stand_ins())


def act(body: Callable[[Scene], Awaitable[None]], specification: Specification, *, both_write: bool = False) -> None:
    system = System(specification, [specification])
    violated: list[str] = []
    system.invariants.begin(lambda: 1e9, lambda: 1e9, bool, bool, violated.append, moved=("lidar", "detector"))

    async def main() -> None:
        manager = system.new_manager()
        scene = Scene(system, manager)
        observe = system.platform.network.on_publish

        def heard(writer: SimulatedWriter) -> None:
            scene.heard(writer)
            observe(writer)

        system.platform.network.on_publish = heard
        await manager.up()
        await asyncio.sleep(5.0)
        await body(scene)

    try:
        system.run(main())
        assert bool(violated) == both_write, violated
    finally:
        system.close()


@pytest.mark.parametrize("host", [OWN_HOST, "arm"])
def test_the_fallback_takes_over_once_the_lease_is_over_and_the_old_one_is_ended_when_its_host_is_back(
    host: str,
) -> None:
    async def body(scene: Scene) -> None:
        cut_at = scene.now()
        scene.cut("base", 40.0)
        await asyncio.sleep(7.0)
        status = await scene.manager.status()
        (base,) = [each for each in status.hosts if each.name == "base"]
        where = "host arm" if host else "the host of the manager"
        assert [words.partition(" in ")[0] for words in base.fallbacks] == [
            f"Lidar on {where} takes the place of lidar"
        ]
        why = await scene.manager.why("lidar.scan")
        assert base.fallbacks[0].partition(" in ")[0] in why.remedies[0]
        await asyncio.sleep(13.0)
        silent, started = scene.last("/scan", "lidar"), scene.first("/scan", "lidar_2")
        assert cut_at + SECONDS / 2 < silent < cut_at + SECONDS
        assert cut_at + SECONDS < started < cut_at + SECONDS * LEASE_SLACK + LOOK + STARTED
        assert scene.on("/scan", cut_at) == ["lidar", "lidar_2"]
        assert scene.running.count("lidar") == 1 and "lidar" not in scene.manager.configuration.instances
        assert "lidar is silent: host base cannot be reached, and its lease of 8 s is over" in scene.notes()
        await asyncio.sleep(40.0)
        assert scene.on("/scan", cut_at) == ["lidar", "lidar_2"]
        assert scene.running == ["detector", "driver", "guard", "lidar_2", "mapper", "planner"]
        assert scene.system.recorded() == scene.running
        assert scene.manager.specification.nodes["lidar"].host == host
        assert (await scene.manager.status()).condition.state == "up"

    act(body, spread(host=host))


def test_what_relies_on_a_node_behind_the_cut_is_restored_without_a_command_when_it_is_back() -> None:
    """The guard, which reads the topic, is on the host that is cut off too, and what reads from it is not."""

    async def body(scene: Scene) -> None:
        scene.cut("arm", 40.0)
        await asyncio.sleep(90.0)
        assert scene.running == ["detector_2", "driver", "guard", "lidar", "mapper", "planner"]
        assert (await scene.manager.status()).condition.state == "up"

    act(body, spread("detector", "base"))


def test_a_link_that_is_back_before_the_lease_is_over_leaves_everything_as_it_was() -> None:
    async def body(scene: Scene) -> None:
        begun, before = scene.now(), scene.running
        for _ in range(3):
            scene.cut("base", 6.0)
            await asyncio.sleep(30.0)
        assert scene.on("/scan", begun) == ["lidar"] and scene.running == before

    act(body, spread(seconds=30.0))


def test_a_component_without_a_renewal_is_silent_until_it_gets_one_and_nothing_takes_its_place() -> None:
    async def body(scene: Scene) -> None:
        begun, before = scene.now(), scene.running
        scene.system.platform.faults.fail_next("lidar", "keep_lease", times=3)
        await asyncio.sleep(40.0)
        times = [at for at, _ in scene.written["/scan"] if at > begun]
        gap = max(after - at for at, after in pairwise(times))
        assert 3.0 < gap < 20.0
        assert scene.on("/scan", begun) == ["lidar"] and scene.running == before
        assert (await scene.manager.status()).condition.state == "up"

    act(body, spread())


def test_a_node_without_a_lease_writes_on_and_is_not_started_elsewhere() -> None:
    async def body(scene: Scene) -> None:
        begun, before = scene.now(), scene.running
        scene.cut("base", 60.0)
        await asyncio.sleep(58.0)
        assert scene.last("/scan", "lidar") > begun + 57.0 and scene.running == before
        (base,) = [each for each in (await scene.manager.status()).hosts if each.name == "base"]
        assert base.fallbacks == []

    act(body, spread(seconds=None))


def test_a_manager_that_ends_frees_the_nodes_and_one_that_is_killed_does_not_and_the_next_one_renews_them() -> None:
    async def body(scene: Scene) -> None:
        begun = scene.now()
        await scene.manager.close()
        await asyncio.sleep(60.0)
        assert scene.last("/scan", "lidar") > begun + 59.0
        manager = scene.system.new_manager()
        await manager.up()
        await asyncio.sleep(5.0)
        killed = scene.now()
        scene.system.lives[-1].kill()
        await asyncio.sleep(20.0)
        assert killed < scene.last("/scan", "lidar") < killed + SECONDS
        await scene.system.new_manager().up()
        await asyncio.sleep(10.0)
        assert scene.last("/scan", "lidar") > scene.now() - 1.0 and "lidar" in scene.running

    act(body, spread())


def test_a_node_that_loses_its_fallback_by_a_command_keeps_no_lease_any_more() -> None:
    async def body(scene: Scene) -> None:
        assert (await scene.manager.change(PlanRequest(to=spread(seconds=None)), brief=True)).outcome == "done"
        await asyncio.sleep(3.0)
        begun = scene.now()
        scene.cut("base", 60.0)
        await asyncio.sleep(58.0)
        assert scene.last("/scan", "lidar") > begun + 57.0 and "lidar_2" not in scene.running

    act(body, spread())


def test_the_nodes_of_a_host_that_is_declared_dead_may_run_elsewhere_and_are_ended_there_if_they_run() -> None:
    """It is not dead here, so both write until then."""

    async def body(scene: Scene) -> None:
        with pytest.raises(ManagerError, match="host base is reached, so it is not dead"):
            await scene.manager.declare_dead("base", "ann")
        scene.cut("base", 60.0)
        await asyncio.sleep(10.0)
        move = PlanRequest(on=(("lidar", "manager"),))
        refused = await scene.manager.change(move, brief=True)
        assert refused.outcome == "refused" and "`midstride dead base` says so" in str(refused.because)
        dead = await scene.manager.declare_dead("base", "ann")
        assert (dead.host, dead.instances) == ("base", ["driver", "lidar"])
        assert sorted(scene.manager.system.crashes) == ["driver", "lidar"]
        assert (await scene.manager.change(move, brief=True)).outcome == "done"
        assert "lidar_2" in scene.running
        await asyncio.sleep(70.0)
        assert scene.running == ["detector", "guard", "lidar_2", "mapper", "planner"]
        assert (await scene.manager.change(PlanRequest(restart=("driver",)), brief=True)).outcome == "done"
        assert (await scene.manager.status()).condition.state == "up"

    act(body, spread(seconds=None), both_write=True)


def test_the_next_manager_knows_that_a_host_was_declared_dead_and_ends_what_runs_there_once_it_is_back() -> None:
    async def body(scene: Scene) -> None:
        scene.cut("base", 100.0)
        await asyncio.sleep(10.0)
        await scene.manager.declare_dead("base", "ann")
        moved = await scene.manager.change(PlanRequest(on=(("lidar", "manager"), ("driver", "manager"))), brief=True)
        assert moved.outcome == "done", moved.because
        scene.system.lives[-1].kill()
        await asyncio.sleep(5.0)
        scene.manager = scene.system.new_manager()
        await scene.manager.up()
        assert "driver still counts as exited" in scene.notes() and scene.manager.system.life.silent == {
            "driver",
            "lidar",
        }
        assert {"lidar_2", "driver_2"} < {*scene.manager.configuration.instances} and "driver" in scene.running
        await asyncio.sleep(110.0)
        assert "driver could not be terminated before, and has been now" in scene.notes()
        assert scene.running == sorted(scene.manager.configuration.instances)
        assert sorted(scene.system.recorded()) == scene.running and not scene.manager.system.life.silent

    act(body, spread(seconds=None), both_write=True)


def test_what_a_failed_change_has_left_on_a_host_takes_no_place_either_once_that_is_declared_dead() -> None:
    async def body(scene: Scene) -> None:
        async def before_request(instance: str, op: str) -> None:
            if instance == "lidar_2":
                scene.cut("base", 60.0)

        scene.system.platform.control.before_request = before_request
        restart = PlanRequest(restart=("lidar",))
        assert (await scene.manager.change(restart, brief=True)).outcome == "failed"
        scene.system.platform.control.before_request = None
        move = PlanRequest(on=(("lidar", "manager"),))
        assert (await scene.manager.change(move, brief=True)).outcome == "refused"
        dead = await scene.manager.declare_dead("base", "ann")
        assert (dead.instances, dead.nodes) == (["driver", "lidar"], ["driver", "lidar"])
        moved = await scene.manager.change(move, brief=True)
        assert moved.outcome == "done", moved.because
        await asyncio.sleep(75.0)
        assert [each for each in scene.running if each.startswith("lidar")] == list(
            scene.manager.configuration.instances_by_role["lidar"]
        )
        leases = scene.manager._leases
        scene.cut("base", 30.0)
        await asyncio.sleep(10.0)
        scene.manager.system.life.give_up("driver")
        assert not leases.is_given_up("driver", "base"), "it was declared dead before, and was reached since"

    act(body, spread(seconds=None), both_write=True)


def test_a_fallback_that_does_not_start_leaves_the_node_until_its_host_is_back() -> None:
    async def body(scene: Scene) -> None:
        cut_at = scene.now()
        scene.cut("base", 60.0)
        scene.cut("arm", 60.0)
        await asyncio.sleep(55.0)
        assert "lidar will not be restarted again" in scene.notes()
        assert scene.on("/scan", cut_at + SECONDS) == []
        await asyncio.sleep(60.0)
        assert sorted(scene.manager.configuration.instances_by_role["lidar"]) != []
        assert len([each for each in scene.running if each.startswith("lidar")]) == 1
        assert scene.written["/scan"][-1][0] > scene.now() - 1.0
        assert scene.manager.specification.nodes["lidar"].host == "base"

    act(body, spread(host="arm"))


def test_no_seed_of_the_system_with_fallbacks_violates_an_invariant() -> None:
    failed = [run for run in simulate_many(range(20), name="leased") if run.problems]
    assert not failed, [f"midstride simulate --system leased --seed {run.seed}: {run.problems[0]}" for run in failed]


@pytest.mark.parametrize("name", ["fallback lease not checked", "fallback lease not awaited"])
def test_a_fault_in_the_leases_is_found(name: str) -> None:
    with planted(name) as words:
        runs = simulate_many(range(200), name="leased")
        assert any(words in problem for run in runs for problem in run.problems)
