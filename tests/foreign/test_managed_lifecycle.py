"""Lifecycle nodes that another program manages, in virtual time: what may be replaced, and what a plan refuses."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.errors import CommandRefused, PlanRefused
from midstride.foreign import graph_watch, lifecycle_managers
from midstride.foreign.graph_check import GraphEndpoint, Served
from midstride.foreign.graph_watch import GRAPH_LOOK
from midstride.foreign.lifecycle_managers import LifecycleManager, reason_to_stay
from midstride.foreign.lifecycle_transitions import ACTIVE, INACTIVE
from midstride.model.contract import QoS
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.runtime.change.managed_nodes import PLAN_LOOK
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.foreign import simulated
from tests.foreign.chat import chat
from tests.foreign.simulated import SimulatedNode, SimulatedRos, _Transport

MANAGER = LifecycleManager("/manager", asks=True)
NAV2: dict[str, Any] = {"node_names": ["planner"], "autostart": True}
PLANNER = """system robot
component Planner { run "planner" gate none }
component Slow { run "planner" activate 9 s gate none }
component Hasty { run "planner" activate 2 s gate none }
component Broken { run "planner" gate none }
node planner : Planner
"""
BEHAVIOUR: dict[str, dict[str, Any]] = {
    "Slow": {"slow": {"activate": 8.0}},
    "Hasty": {"slow": {"activate": 8.0}},
    "Broken": {"refuses": {ACTIVE}},
}
RESTART = PlanRequest(restart=("planner",))


def said(plan: Plan) -> str:
    continuity = PlanPreview.of(plan).continuity
    assert continuity
    return continuity.headline


class ManagedRos(SimulatedRos):
    """A simulator whose nodes are lifecycle nodes of ``managers``, as the graph shows them."""

    managers: tuple[LifecycleManager, ...] = (MANAGER,)

    def _agents(self) -> ForeignNodes:
        services = self._services_of
        return ForeignNodes(self._folder, _Transport(self.control), services, served=self._served)

    def _services_of(self, node: str) -> SimulatedNode | None:
        return self.nodes.get(node.strip("/"))

    def _served(self, node: str, services: frozenset[str] | None, mark: bytes | None) -> Served:
        """The manager knows the first node of its name."""
        known = node in ("/planner", "/talker")
        return Served((), has_lifecycle=True, managers=self.managers if known else ())

    def runs_manager(self, **parameters: Any) -> None:
        self.nodes["manager"] = SimulatedNode("manager", self.events, values=parameters)


class StartingRos(ManagedRos):
    """A simulator with a graph, in which ``seen`` is what it shows of the nodes; the rest of them cannot be asked."""

    def __init__(self, folder: Path) -> None:
        self.managers = ()
        self.seen: dict[str, list[str]] = {"/planner": ["/plan"]}
        super().__init__(folder)

    def _agents(self) -> ForeignNodes:
        return ForeignNodes(
            self._folder, _Transport(self.control), self._services_of, graph=self._graph, served=self._served
        )

    def _graph(self, node: str, mark: bytes | None) -> list[GraphEndpoint]:
        topics = self.seen.get(node, self.seen["/planner"] if node.startswith("/planner") else [])
        return [GraphEndpoint(True, topic, "std_msgs/msg/String", QoS()) for topic in topics]

    def _served(self, node: str, services: frozenset[str] | None, mark: bytes | None) -> Served:
        return super()._served(node, services, mark) if node.startswith("/planner") else Served()


STARTING = (
    PLANNER
    + """component Manager { run "manager" gate none }
node manager : Manager
"""
)


def starting(folder: Path, body: Callable[[Manager, StartingRos], Awaitable[None]], text: str = STARTING) -> None:
    """Have ``body`` begin as soon as the planner and its manager have been started."""
    simulator = StartingRos(folder / "gates")

    async def begun(manager: Manager, _: SimulatedRos) -> None:
        simulator.nodes["planner"].state = ACTIVE
        await body(manager, simulator)

    simulated.managed(folder, text, begun, simulator=simulator)


def later(simulator: StartingRos, seconds: float, *, topics: list[str], calls: bool) -> None:
    """Have the graph show this of the manager in so many seconds; ``calls``: that it changes the planner's state."""

    def shown() -> None:
        simulator.seen["/manager"] = topics
        simulator.managers = (MANAGER,) if calls else ()

    asyncio.get_running_loop().call_later(seconds, shown)


def managed(
    folder: Path, body: Callable[[Manager, ManagedRos], Awaitable[None]], text: str = PLANNER, **parameters: Any
) -> None:
    simulator = ManagedRos(folder / "gates", BEHAVIOUR)
    simulator.runs_manager(**parameters)

    async def begun(manager: Manager, _: SimulatedRos) -> None:
        if "planner" in simulator.nodes:
            simulator.nodes["planner"].state = ACTIVE  # its manager has done that
        await asyncio.sleep(2 * GRAPH_LOOK)
        await body(manager, simulator)

    simulated.managed(folder, text, begun, simulator=simulator)


@pytest.mark.parametrize(
    ("manager", "parameters", "because"),
    [
        (MANAGER, {**NAV2, "bond_timeout": 4.0}, "/manager has a bond of 4 s with /planner"),
        (replace(MANAGER, bond=True), {}, "/manager has a bond with /planner, which another process cannot continue"),
        (MANAGER, {}, "/manager may ask /planner/get_state at any time"),
        (MANAGER, {"bond_timeout": 0.0}, "/manager may ask /planner/get_state"),
        (MANAGER, {**NAV2, "bond_timeout": 0.0}, None),
        (replace(MANAGER, asks=False), {}, None),
    ],
)
def test_what_a_manager_would_notice_is_known_by_its_calls_and_by_nav2_s_parameters(
    manager: LifecycleManager, parameters: dict[str, Any], because: str | None
) -> None:
    found = reason_to_stay("/planner", manager, parameters)
    assert found is None if because is None else because in str(found)


@pytest.mark.parametrize("request_", [RESTART, PlanRequest(remove=("planner",))])
def test_what_would_make_a_manager_deactivate_all_is_refused_in_the_plan(tmp_path: Path, request_: PlanRequest) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        with pytest.raises(PlanRefused, match="planner cannot be replaced or removed") as refused:
            await manager.plan(request_)
        assert "has a bond of 4 s" in str(refused.value) and "--lifecycle midstride" in str(refused.value)
        outcome = await manager.change(request_)
        assert (outcome.outcome, outcome.because) == ("refused", str(refused.value))
        assert simulator.events == [] and simulator.nodes["planner"].state == ACTIVE

    managed(tmp_path, body, **NAV2, bond_timeout=4.0)


def test_a_manager_that_has_ended_holds_nothing_back_at_once(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        simulator.managers = ()
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert simulator.active() == ["planner_2"], "it is taken to the state of the old one all the same"

    managed(tmp_path, body)


def test_where_the_manager_does_not_notice_the_successor_is_active_before_the_old_one_ends(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        plan = PlanPreview.of(await manager.plan(RESTART)).continuity
        assert plan and plan.verdict == "not_measurable"
        assert "its lifecycle services (called by /manager)" in plan.headline
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert simulator.events == ["planner_2 configure", "planner_2 activate", "planner ended"]
        # The next one is managed by nothing: it is taken to the state of this one as well.
        assert (await manager.change(RESTART)).outcome == "done"
        assert simulator.active() == ["planner_3"]

    managed(tmp_path, body, **NAV2, bond_timeout=0.0)


def test_the_successor_of_a_node_that_is_not_active_is_not_active(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        simulator.nodes["planner"].state = INACTIVE  # its manager has paused all
        assert (await manager.change(RESTART)).outcome == "done"
        assert simulator.events == ["planner_2 configure", "planner ended"]

    managed(tmp_path, body, **NAV2, bond_timeout=0.0)


def test_a_successor_that_does_not_become_active_in_its_time_leaves_the_old_one_as_it_is(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        outcome = await manager.change(PlanRequest(replace=(("planner", "Hasty"),)))
        assert outcome.outcome == "rolled_back"
        assert "planner_2 has not answered `activate` within 2 s" in str(outcome.because)
        assert simulator.active() == ["planner"] and "planner ended" not in simulator.events
        outcome = await manager.change(PlanRequest(replace=(("planner", "Slow"),)))
        assert (outcome.outcome, outcome.because) == ("done", None)

    managed(tmp_path, body, **NAV2, bond_timeout=0.0)


def test_a_manager_that_comes_while_a_change_is_under_way_keeps_the_old_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lifecycle_managers, "_REMEMBERED", 0.0)

    async def body(manager: Manager, simulator: ManagedRos) -> None:
        change = asyncio.ensure_future(manager.change(PlanRequest(replace=(("planner", "Slow"),))))
        await asyncio.sleep(1.0)
        simulator.nodes["manager"].values["bond_timeout"] = 4.0
        outcome = await change
        assert outcome.outcome == "rolled_back" and "has a bond of 4 s with /planner" in str(outcome.because)
        assert simulator.active() == ["planner"]

    managed(tmp_path, body, **NAV2, bond_timeout=0.0)


def test_a_plan_right_after_the_start_waits_until_the_manager_calls(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: StartingRos) -> None:
        later(simulator, 1.0, topics=["/diagnostics"], calls=False)
        later(simulator, 2.5, topics=["/diagnostics"], calls=True)
        begun = asyncio.get_running_loop().time()
        with pytest.raises(PlanRefused, match="lifecycle manager /manager may ask /planner/get_state"):
            await manager.plan(PlanRequest(remove=("planner",)))
        assert 2.5 <= asyncio.get_running_loop().time() - begun < 3.0
        assert simulator.active() == ["planner"]

    starting(tmp_path, body)


def test_what_no_manager_calls_once_all_have_started_is_known_not_to_be_managed(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: StartingRos) -> None:
        later(simulator, 0.0, topics=["/diagnostics"], calls=False)
        loop = asyncio.get_running_loop()
        begun = loop.time()
        plan = await manager.plan(RESTART)
        assert loop.time() - begun < PLAN_LOOK and "lifecycle manager" not in said(plan)
        begun = loop.time()
        await manager.plan(RESTART)
        assert loop.time() - begun < 0.1, "it is known now"
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert outcome.continuity and "lifecycle manager" not in outcome.continuity.headline

    starting(tmp_path, body)


def test_what_the_specification_says_of_a_manager_needs_no_graph(tmp_path: Path) -> None:
    stated = 'parameters { autostart = true  node_names = ["planner"] }'
    text = STARTING.replace('run "manager" gate none', f'run "manager" gate none {stated}')

    async def body(manager: Manager, simulator: StartingRos) -> None:
        simulator.seen["/planner"] = []
        loop = asyncio.get_running_loop()
        begun = loop.time()
        with pytest.raises(PlanRefused, match="lifecycle manager /manager has a bond of 4 s with /planner"):
            await manager.plan(RESTART)
        assert loop.time() == begun and simulator.active() == ["planner"]
        assert (await manager.change(PlanRequest(remove=("manager",)))).outcome == "done"
        assert (await manager.change(RESTART)).outcome == "done"

    starting(tmp_path, body, text)


def test_what_a_plan_could_not_ask_is_said_to_be_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def hung(*_: object) -> None:
        raise CommandRefused("no answer")

    async def body(manager: Manager, simulator: StartingRos) -> None:
        later(simulator, 0.0, topics=["/diagnostics"], calls=False)
        await asyncio.sleep(2 * GRAPH_LOOK)
        monkeypatch.setattr(graph_watch.GraphWatch, "look", hung)
        outcome = await manager.change(PlanRequest(remove=("planner",)))
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert outcome.continuity and f"{UNKNOWN}ended: what answers for planner did not look" in (
            outcome.continuity.headline
        )
        assert f"{UNKNOWN}ends: what answers for planner does not look" in str(outcome.plan)

    starting(tmp_path, body)


def test_a_program_without_ports_that_ends_in_its_first_second_is_in_the_report(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        simulator.managers = ()
        simulator.die("planner")
        await asyncio.sleep(0.1)
        loop = asyncio.get_running_loop()
        begun = loop.time()
        change = asyncio.ensure_future(manager.change(RESTART))
        await asyncio.sleep(0.5)
        assert manager.log()[-1].kind in ("step_done", "measuring") and not change.done()
        simulator.die("planner")
        outcome = await change
        assert outcome.outcome == "done" and outcome.unexpected_exits == ["planner"]
        assert outcome.continuity and outcome.continuity.verdict == "lost" and loop.time() - begun < 2.0

    managed(tmp_path, body)


UNKNOWN = "whether a lifecycle manager deactivates its nodes as planner "


def test_what_a_plan_could_not_learn_in_time_is_said_to_be_unknown(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: StartingRos) -> None:
        loop = asyncio.get_running_loop()
        begun = loop.time()
        later(simulator, PLAN_LOOK - 1.0, topics=["/diagnostics"], calls=False)
        plan = await manager.plan(PlanRequest(remove=("planner",)))
        assert PLAN_LOOK <= loop.time() - begun < PLAN_LOOK + 0.1
        because = "manager has just been started, and may be one"
        assert f"{UNKNOWN}ends: {because}" in said(plan)

    starting(tmp_path, body)


def test_what_was_not_known_when_the_node_ended_is_not_known_in_the_report(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: StartingRos) -> None:
        later(simulator, PLAN_LOOK - 1.0, topics=["/diagnostics"], calls=False)
        outcome = await manager.change(PlanRequest(remove=("planner",)))
        assert (outcome.outcome, outcome.because) == ("done", None)
        because = "manager had just been started, and may be one"
        assert outcome.continuity and f"{UNKNOWN}ended: {because}" in outcome.continuity.headline

    starting(tmp_path, body)


def test_a_manager_that_calls_after_the_plan_keeps_the_node(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: StartingRos) -> None:
        later(simulator, PLAN_LOOK + 0.05, topics=["/diagnostics"], calls=True)
        outcome = await manager.change(PlanRequest(remove=("planner",)))
        assert outcome.outcome == "rolled_back" and "/manager may ask /planner/get_state" in str(outcome.because)
        assert simulator.active() == ["planner"]

    starting(tmp_path, body)


def test_the_next_manager_of_midstride_waits_until_its_own_graph_shows_the_node(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: StartingRos) -> None:
        later(simulator, 0.0, topics=["/diagnostics"], calls=False)
        await asyncio.sleep(2 * GRAPH_LOOK)
        shown, simulator.seen = simulator.seen, {"/planner": []}
        simulator.managers = ()
        await manager.close()
        await simulator.manager_killed()
        second = Manager(manager.specification, simulator, Workspace(tmp_path / "system"), tmp_path)
        await second.up()

        def discovered() -> None:
            simulator.seen, simulator.managers = shown, (MANAGER,)

        asyncio.get_running_loop().call_later(1.5, discovered)
        with pytest.raises(PlanRefused, match="lifecycle manager /manager may ask /planner/get_state"):
            await second.plan(PlanRequest(remove=("planner",)))
        await second.close()

    starting(tmp_path, body)


def test_that_two_programs_manage_a_node_is_a_fault_of_the_status(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        (said, *_) = (each for each in (await manager.status()).condition.faults if "/talker" in each)
        assert "lifecycle manager /manager changes the state of /talker, and so does Midstride" in said
        simulator.managers = ()
        await asyncio.sleep(2 * GRAPH_LOOK)
        assert (await manager.status()).condition.state == "up"

    managed(tmp_path, body, chat("lifecycle"))


def test_a_lifecycle_node_that_states_no_ports_yet_is_active_from_its_start(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ManagedRos) -> None:
        assert simulator.active() == ["planner"]
        revision = manager.system.life.latest_states["planner"].state.revision
        simulator.nodes["planner"].state = INACTIVE
        await asyncio.sleep(2 * GRAPH_LOOK)
        (fault,) = (await manager.status()).condition.faults
        assert fault == "lifecycle node /planner is inactive, and was active before"
        assert manager.system.life.latest_states["planner"].state.revision == revision
        simulator.nodes["planner"].state = ACTIVE
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None) and simulator.active() == ["planner_2"]

    simulator = ManagedRos(tmp_path / "gates")
    simulator.managers = ()

    async def begun(manager: Manager, _: SimulatedRos) -> None:
        await asyncio.sleep(2 * GRAPH_LOOK)
        await body(manager, simulator)

    simulated.managed(tmp_path, PLANNER.replace("gate none", "gate lifecycle"), begun, simulator=simulator)
