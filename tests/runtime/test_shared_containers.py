"""Nodes that share a container, on the simulator: in which process each is restarted, and what ends the others."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from pathlib import Path

import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.model.component import DEFAULT_CONTAINER
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Specification
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Exited, Handle, Launch
from midstride.runtime.manager import Manager
from midstride.runtime.timeouts import within
from midstride.runtime.workspace import Workspace
from midstride.wire.state import ComponentState
from tests.runtime.systems import EXAMPLES, example, managed

POLICY = RespawnPolicy()


class Grouped(Simulator):
    """Nodes of a container end together, as in the process that they share."""

    def __init__(self) -> None:
        super().__init__()
        self.groups: dict[str, str] = {}
        self.launches: list[Launch] = []
        self.loading: set[str] = set()
        self.at_fault: set[str] = set()

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        await super().open(lambda event: on_exit(changed(event, loading=event.instance in self.at_fault)))

    async def start(self, launch: Launch) -> Handle:
        self.launches.append(launch)
        self.groups[launch.instance] = launch.process
        if launch.process:
            self.loading.add(launch.instance)
        handle = await super().start(launch)
        self.processes[launch.instance].shares = ""  # what ends together is decided here, also while nodes are loaded
        return handle

    def reported(self, state: ComponentState) -> None:
        self.loading.discard(state.instance)

    def _exited(self, process: SimulatedProcess) -> None:
        super()._exited(process)
        group = self.groups.pop(process.instance, "")
        if group and process.instance in self.loading:
            self.at_fault.add(process.instance)
        if group and not process.exit_expected:
            for other in [name for name, shared in self.groups.items() if shared == group]:
                self.loading.discard(other)
                self.processes[other].kill()


def grouped(policy: RespawnPolicy | None = POLICY, program: Path | None = None) -> Specification:
    """Talker, listener and a further talker in one container; ``program``: of the talker."""
    specification = changed(example("talker"), containers=Map(pipeline=DEFAULT_CONTAINER))
    talker = specification.components["Talker"]
    if program is not None:
        program.write_text((EXAMPLES / "talker" / "talker.py").read_text())
        own = changed(talker, run=f"python3 {program}")
        specification = changed(specification, components=specification.components.set("Talker", own))
    for role in ("talker", "listener"):
        node = changed(specification.nodes[role], respawn=policy, container="pipeline")
        specification = specification.with_node(node)
    return specification


def processes(manager: Manager) -> dict[str, str]:
    return {each.role: each.process for each in manager.configuration.instances.values()}


async def until(holds: Callable[[], bool]) -> None:
    async with within(60.0):
        while not holds():
            await asyncio.sleep(0.001)


async def restored(manager: Manager) -> None:
    await until(lambda: sorted(processes(manager)) == ["listener", "talker"])


def run(
    body: Callable[[Manager, Grouped], Awaitable[None]],
    folder: Path,
    specification: Specification | None = None,
) -> None:
    simulator = Grouped()
    managed("talker", folder, lambda manager, _: body(manager, simulator), simulator, specification or grouped())


async def alone(manager: Manager) -> str:
    """Have the talker leave the container; the name of its instance."""
    done = await manager.change(PlanRequest(restart=("talker",)))
    assert done.outcome == "done", done.because
    assert processes(manager) == {"talker": "", "listener": "pipeline"}
    [found] = manager.configuration.instances_by_role["talker"]
    return found


# -- one that has left its container ---------------------------------------------------------------------------


def test_one_that_has_left_is_restarted_in_a_process_for_itself_until_all_are_together_again(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Grouped) -> None:
        assert set(processes(manager).values()) == {"pipeline"}
        for _ in range(2):
            simulator.faults.kill(await alone(manager))
            await until(lambda: "talker" not in processes(manager))
            await restored(manager)
            assert processes(manager) == {"talker": "", "listener": "pipeline"}
        done = await manager.change(PlanRequest(restart=("pipeline",)))
        assert done.outcome == "done", done.because
        assert processes(manager) == dict.fromkeys(("talker", "listener"), "pipeline_2")
        simulator.faults.kill("listener_2")
        await until(lambda: not processes(manager))
        await restored(manager)
        assert processes(manager) == dict.fromkeys(("talker", "listener"), "pipeline")

    run(body, tmp_path)


def test_it_does_not_join_the_others_when_all_crash(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Grouped) -> None:
        simulator.faults.kill(await alone(manager))
        simulator.faults.kill("listener")
        await until(lambda: not processes(manager))
        await restored(manager)
        assert processes(manager) == {"talker": "", "listener": "pipeline"}

    run(body, tmp_path)


def test_a_command_restarts_it_where_it_was_and_the_containers_name_brings_it_back(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Grouped) -> None:
        simulator.faults.kill(await alone(manager))
        await until(lambda: "talker" not in processes(manager))
        await asyncio.sleep(1)
        plan = await manager.plan(PlanRequest(restart=("talker",)))
        assert any("talker starts in a process for itself" in each for each in plan.remarks), plan.remarks
        again = decode_plan(encode_plan(plan))
        assert [each.process for each in again.change.coming] == [each.process for each in plan.change.coming] == [""]
        together = await manager.plan(PlanRequest(restart=("pipeline",)))
        assert {each.process for each in together.change.coming} == {"pipeline_2"}
        done = await manager.change(PlanRequest(restart=("talker",)))
        assert done.outcome == "done", done.because
        assert processes(manager) == {"talker": "", "listener": "pipeline"}

    run(body, tmp_path, grouped(policy=None))


@pytest.mark.parametrize("crash", ["before", "after"])
def test_the_next_manager_knows_that_it_had_left(tmp_path: Path, crash: str) -> None:
    """Whether it has crashed before or after the end of the manager before."""
    simulator, specification, workspace = Grouped(), grouped(policy=None), Workspace(tmp_path)

    async def main() -> None:
        first = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        await first.up()
        name = await alone(first)
        if crash == "before":
            simulator.faults.kill(name)
            await until(lambda: "talker" not in processes(first))
        await first.close()
        if crash == "after":
            simulator.faults.kill(name)
            await asyncio.sleep(1)
        second = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        try:
            await second.up()
            assert processes(second) == {"talker": "", "listener": "pipeline"}
        finally:
            await second.close()

    simulator.run(main())


# -- one that ends its container as it is loaded ---------------------------------------------------------------


def test_one_that_ends_its_container_as_it_is_loaded_gets_no_second_chance_there(tmp_path: Path) -> None:
    program = tmp_path / "talker.py"

    async def body(manager: Manager, simulator: Grouped) -> None:
        program.write_text("raise SystemExit(3)")
        simulator.faults.kill("listener")
        await until(lambda: not processes(manager))
        await until(lambda: "listener" in processes(manager))
        await asyncio.sleep(150)
        assert processes(manager) == {"listener": "pipeline"}
        commands = [event.words for event in manager.log() if event.kind == "command"]
        assert commands.count("respawn listener") + commands.count("respawn talker") < 2 + (POLICY.max_retries or 0)
        [note] = [event.words for event in manager.log() if "beside others" in event.words]
        assert note == (
            "talker is not loaded beside others again until `midstride restart pipeline`: pipeline exited, or did not "
            "answer, while it was loading talker"
        )
        [ended] = [event.words for event in manager.log() if event.kind == "respawn_ended"]
        assert "talker will not be restarted again" in ended

    run(body, tmp_path, grouped(program=program))


@pytest.mark.parametrize("policy", [None, POLICY], ids=["without a policy", "with one"])
def test_it_does_not_keep_the_others_away_when_the_system_is_brought_up(
    tmp_path: Path, policy: RespawnPolicy | None
) -> None:
    program = tmp_path / "talker.py"
    simulator, specification, workspace = Grouped(), grouped(policy, program), Workspace(tmp_path / "workspace")
    program.write_text("raise SystemExit(3)")

    async def main() -> None:
        manager = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        try:
            report = await manager.up()
            assert [*report.missing] == ["talker"]
            assert processes(manager) == {"listener": "pipeline"}
        finally:
            await manager.close()

    simulator.run(main())


# -- a roll-back -----------------------------------------------------------------------------------------------


def test_a_roll_back_in_the_middle_of_moving_all_returns_each_to_the_process_that_it_had(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Grouped) -> None:
        moving = asyncio.ensure_future(manager.change(PlanRequest(restart=("pipeline",))))
        await until(lambda: len(simulator.processes) == 3 and "pipeline_2" in simulator.groups.values())
        await until(lambda: not {"talker", "listener"} <= set(simulator.processes))
        simulator.launches.clear()
        moving.cancel()
        await asyncio.wait({moving})
        assert set(processes(manager).values()) == {"pipeline"}, manager.log()[-1]
        assert sorted(simulator.processes) == ["listener", "talker"]
        assert {(each.process, each.returns) for each in simulator.launches} == {("pipeline", True)}

    run(body, tmp_path)
