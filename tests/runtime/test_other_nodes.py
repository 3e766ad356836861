"""Processes with further nodes on the simulator: what ends them with one of its nodes is refused, or says so."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from dataclasses import replace as changed
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.model.component import StopTimes
from midstride.model.configuration import Instance
from midstride.model.respawn import RespawnPolicy
from midstride.plan.expected_losses import expected_losses
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import OtherNode, OtherNodes, RemainingProcess
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.view.instance_status import _misnamed
from midstride.runtime.watch.other_nodes import INTERVAL
from midstride.runtime.workspace import Workspace
from midstride.verdicts.assessment import Assessment
from tests.runtime.systems import EXAMPLES, example, managed, replace, saved

CAMERA = OtherNode("/camera", ("/image",), ("service /save",))
UNKNOWN = "this middleware does not tell which process a node belongs to"
REFUSED = (
    "the change would also end another node of the same process: /camera with talker. If it is meant too, pass "
    '`--with-other-nodes` (`"with_other_nodes": true` in a request)'
)


class Container(Simulator):
    """Others have loaded nodes into some of its processes."""

    shares_processes = True

    def __init__(self) -> None:
        super().__init__()
        self.loaded: dict[str, OtherNodes] = {}

    def load(self, instance: str, *nodes: OtherNode, unknown: str | None = None) -> None:
        self.loaded[instance] = OtherNodes(nodes, unknown)

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        killed = await super().end(instance, stop)
        self.loaded.pop(instance, None)  # a new process of that name has none
        return killed

    def other_nodes(self, instances: Collection[str]) -> dict[str, OtherNodes]:
        return {name: found for name, found in self.loaded.items() if name in instances and name in self.processes}


def words(found: list[Assessment], subject: str) -> list[tuple[str, str]]:
    return [(each.verdict, each.words) for each in found if each.subject == subject]


def notes(manager: Manager) -> list[str]:
    return [event.words for event in manager.log() if event.kind == "note"]


REQUESTS = {
    "replace": replace("talker", "NewTalker"),
    "restart": PlanRequest(restart=("talker",)),
    "remove": PlanRequest(remove=("talker",)),
    "another one that stops everything": PlanRequest(restart=("listener",), strategy="stop"),
    "apply": PlanRequest(to=example("talker").with_replaced("talker", "NewTalker")),
    "apply without it": PlanRequest(to=example("talker").without_node("talker")),
}


@pytest.mark.parametrize("asked", REQUESTS.values(), ids=[*REQUESTS])
def test_what_would_end_other_nodes_is_refused_with_their_names_and_changes_nothing(
    asked: PlanRequest, tmp_path: Path
) -> None:
    """They are asked for when the change is: what others load after the start counts, what they unload does not."""
    container = Container()

    async def body(manager: Manager, simulator: Simulator) -> None:
        before, processes = manager.configuration, set(simulator.processes)
        container.load("talker", CAMERA)
        outcome = await manager.change(asked)
        assert (outcome.outcome, outcome.because) == ("refused", REFUSED)
        assert (manager.configuration, set(simulator.processes)) == (before, processes)
        container.load("talker")
        assert (await manager.change(asked)).outcome == "done"

    managed("talker", tmp_path, body, container)


def test_a_change_that_leaves_the_process_alone_is_not_refused(tmp_path: Path) -> None:
    container = Container()

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        container.load("talker", CAMERA)
        return await manager.change(PlanRequest(restart=("listener",)))

    assert managed("talker", tmp_path, body, container).outcome == "done"


def test_what_ends_is_in_plan_and_report_where_it_is_meant(tmp_path: Path) -> None:
    """One of two nodes is loaded into the new process as well: for how long it did nothing is not measured."""
    container, second = Container(), OtherNode("/lidar")

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        container.load("talker", CAMERA, second)
        container.load("talker_2", second)
        request = changed(replace("talker", "NewTalker"), with_other_nodes=True)
        expected = expected_losses(await manager.plan(request))
        end = "ends with talker, whose process it is in; whether the new instance has it is not known"
        assert words(expected.found, "/camera") == [
            ("lost", f"node /camera (publishes on /image; serves service /save) {end}")
        ]
        assert words(expected.found, "/lidar") == [("lost", f"node /lidar {end}")]
        assert expected.verdict == "lost"
        outcome = await manager.change(request)
        assert notes(manager) == ["talker is ended; with it: nodes /camera, /lidar"]
        return outcome

    outcome = managed("talker", tmp_path, body, container)
    assert outcome.outcome == "done" and outcome.continuity is not None
    assert words(outcome.continuity.found, "/camera") == [
        (
            "lost",
            "node /camera (publishes on /image; serves service /save) ended with talker, and had not been started "
            "again when this was reported",
        )
    ]
    assert words(outcome.continuity.found, "/lidar") == [
        (
            "not_measurable",
            "what node /lidar does: it ended with talker, and talker_2 has such a node; for how long it did nothing "
            "is not measured",
        )
    ]
    assert outcome.continuity.headline == "Lost: /camera; 1 not measurable here."
    assert not outcome.continuity.lasting, "it was asked for"


def test_where_they_cannot_be_known_plan_and_report_say_so_and_nothing_is_refused(tmp_path: Path) -> None:
    container = Container()

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        container.load("talker", unknown=UNKNOWN)
        request = PlanRequest(restart=("talker",))
        expected = expected_losses(await manager.plan(request))
        assert expected.headline == (
            f"Nothing is known to degrade. Not measurable here: which other nodes end with talker: {UNKNOWN}."
        )
        [talker] = [each for each in (await manager.status()).instances if each.name == "talker"]
        assert (talker.other_nodes, talker.other_nodes_unknown) == ([], UNKNOWN)
        return await manager.change(request)

    outcome = managed("talker", tmp_path, body, container)
    assert outcome.continuity is not None
    assert words(outcome.continuity.found, "talker") == [
        ("not_measurable", f"which other nodes end with talker: {UNKNOWN}")
    ]


def test_a_wrong_renames_is_a_difference_with_the_nodes_that_the_process_has() -> None:
    component = changed(example("talker").components["Talker"], gate="none", renames="lidar")
    instance = Instance("talker", "talker", component)
    assert list(_misnamed(instance, OtherNodes((CAMERA,), without_own=True))) == [
        "`renames lidar` is the name of no node of its process, which has node /camera: state what the program calls "
        "the one that is meant"
    ]
    assert not list(_misnamed(instance, OtherNodes((CAMERA,))))
    unnamed = changed(instance, component=changed(component, renames=None))
    assert not list(_misnamed(unnamed, OtherNodes((CAMERA,), without_own=True)))


def test_a_roll_back_that_starts_the_process_again_says_what_it_lacks(tmp_path: Path) -> None:
    """With the strategy `paper`, the old process ends first, and the new one cannot be started."""
    container, specification = Container(), example("talker")
    broken = changed(specification.components["NewTalker"], run="python3 broken.py")
    specification = changed(specification, components=specification.components.set("NewTalker", broken))

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        container.load("talker", CAMERA)
        return await manager.change(changed(replace("talker", "NewTalker", "paper"), with_other_nodes=True))

    outcome = managed("talker", tmp_path, body, container, specification)
    assert outcome.outcome == "rolled_back" and outcome.continuity is not None
    [(verdict, said)] = words(outcome.continuity.found, "/camera")
    assert verdict == "lost" and said.endswith("had not been started again when this was reported")
    assert outcome.continuity.lasting


def test_a_crash_names_them_and_the_node_is_restarted_all_the_same(tmp_path: Path) -> None:
    container, specification = Container(), example("talker")
    talker = changed(specification.nodes["talker"], respawn=RespawnPolicy(delay=1.0, max_retries=3, window=60.0))

    async def body(manager: Manager, simulator: Simulator) -> None:
        container.load("talker", CAMERA)
        [listed] = [each for each in (await manager.status()).instances if each.name == "talker"]
        assert [(each.name, each.publishes, each.serves) for each in listed.other_nodes] == [
            ("/camera", ["/image"], ["service /save"])
        ]
        container.load("talker", CAMERA, OtherNode("/lidar"))
        await asyncio.sleep(2 * INTERVAL)
        simulator.faults.kill("talker")
        await asyncio.sleep(0.5)
        assert [event.words for event in manager.log() if event.kind == "exited"] == [
            "talker exited unexpectedly (status -9); with it ended nodes /camera, /lidar"
        ]
        [crashed] = (await manager.status()).crashed
        assert crashed.words.endswith("with it ended nodes /camera, /lidar")
        await asyncio.sleep(5)
        assert manager.system.has_instance("talker") and not (await manager.status()).crashed

    managed("talker", tmp_path, body, container, specification.with_node(talker))


def test_what_an_earlier_manager_left_half_done_does_not_end_them(tmp_path: Path) -> None:
    """Its specification has no listener, which still runs: nothing but a command may end its process."""
    container, workspace, folder = Container(), Workspace(tmp_path), EXAMPLES / "talker"
    without = example("talker").without_node("listener")

    async def main() -> None:
        first = Manager(example("talker"), container, workspace, folder)
        await first.up()
        await first.close()
        left, store = saved(workspace), StateStore(workspace.state)
        store.begin(left.backend, left.token, without)
        store.close()
        container.load("listener", CAMERA)
        second = Manager(saved(workspace).specification, container, workspace, folder)
        await second.up()
        assert "listener" in container.processes and "listener" in second.configuration.instances
        assert [each for each in notes(second) if each.startswith("what an earlier manager has left half done")] == [
            f"what an earlier manager has left half done stays as it is: {REFUSED.replace('talker', 'listener')}"
        ]
        outcome = await second.change(PlanRequest(to=without, with_other_nodes=True))
        assert (outcome.outcome, "listener" in container.processes) == ("done", False)
        await second.close()

    container.run(main())
