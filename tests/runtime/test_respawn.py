"""Restart policies on the simulator, in virtual time: what is restarted, when, and how it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from functools import partial
from pathlib import Path

import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.model.component import DEFAULT_CONTAINER
from midstride.model.respawn import RespawnPolicy
from midstride.model.rules import violations
from midstride.model.specification import Node, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import CrashedInstance
from midstride.runtime.timeouts import within
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, managed, replace

# What a restart takes on the simulator at most, with the detection of the exit (s).
RESTORED = 1.5


def respawning(policy: RespawnPolicy, role: str = "talker", system: str = "talker") -> Specification:
    specification = example(system)
    return specification.with_node(changed(specification.nodes[role], respawn=policy))


def programmed(specification: Specification, component: str, path: Path) -> Specification:
    """``specification`` with a copy of the component's program, which a test can rewrite."""
    path.write_text((EXAMPLES / "talker" / "talker.py").read_text())
    declared = changed(specification.components[component], run=f"python3 {path}")
    return changed(specification, components=specification.components.set(component, declared))


def words(manager: Manager, kind: str = "respawn") -> list[str]:
    return [event.words for event in manager.log() if event.kind == kind]


async def until(holds: Callable[[], bool]) -> None:
    async with within(60.0):
        while not holds():
            await asyncio.sleep(0.001)


def restarted(manager: Manager, times: int) -> bool:
    """Whether the manager has begun to restart the talker that many times."""
    return words(manager, "command").count("respawn talker") == times


async def crash(simulator: Simulator, instance: str) -> None:
    """Kill a process, and wait until the manager has handled that."""
    simulator.faults.kill(instance)
    await asyncio.sleep(0.1)


async def crashed(manager: Manager) -> CrashedInstance:
    [found] = (await manager.status()).crashed
    return found


def run(
    body: Callable[[Manager, Simulator], Awaitable[None]],
    folder: Path,
    specification: Specification,
    simulator: Simulator | None = None,
) -> None:
    managed("talker", folder, body, simulator, specification)


def test_without_a_policy_a_crashed_node_stays_away(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        await asyncio.sleep(150)
        assert sorted(simulator.processes) == ["listener"]
        found = await crashed(manager)
        assert (found.respawn, found.remedy) == (None, "`midstride restart talker` restores it")
        assert words(manager) == []

    run(body, tmp_path, example("talker"))


def test_a_crashed_node_comes_back_by_an_ordinary_plan_and_its_dependants_are_raised(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        await asyncio.sleep(RESTORED)
        status = await manager.status()
        assert status.valid and status.crashed == [] and violations(manager.configuration) == []
        assert (await manager.why("listener.listen")).mode == "normal"
        assert words(manager) == ["talker exited unexpectedly; restarting talker now (1 of 5 in 60 s)"]
        assert words(manager, "command")[-1] == "respawn talker"
        started = "done; whether talker.out keeps its rate: it has just been started"
        assert words(manager, "outcome") == [started, "done"]
        [plan] = [event.plan for event in manager.log() if event.plan][1:]
        assert [step.action for step in plan.steps] == ["create", "attach", "upgrade", "upgrade"]

    run(body, tmp_path, respawning(RespawnPolicy()))


def test_a_node_that_crashes_again_and_again_is_not_well_when_it_happens_to_run(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        for expected in ("up", "degraded"):
            await asyncio.sleep(RESTORED)
            await crash(simulator, "talker")
            await asyncio.sleep(3 * RESTORED)
            assert "talker" in manager.configuration.instances
            condition = (await manager.status()).condition
            assert condition.state == expected, condition
        (fault,) = condition.faults
        assert fault.startswith("talker has been restarted 2 times in 60 s of running, the last time as talker exited")
        await asyncio.sleep(61)
        assert (await manager.status()).condition.state == "up"

    run(body, tmp_path, respawning(RespawnPolicy()))


def test_a_node_that_cannot_start_keeps_the_others_of_its_container_away_for_one_restart_only(tmp_path: Path) -> None:
    program = tmp_path / "talker.py"
    specification = programmed(example("talker"), "Talker", program)
    specification = changed(specification, containers=Map(pipeline=DEFAULT_CONTAINER))
    for role in ("talker", "listener"):
        node = changed(specification.nodes[role], respawn=RespawnPolicy(), container="pipeline")
        specification = specification.with_node(node)

    async def body(manager: Manager, simulator: Simulator) -> None:
        program.write_text("raise SystemExit(3)")
        begun = simulator.time.steady()
        simulator.faults.kill("talker")  # and the listener with it
        await until(lambda: not manager.configuration.instances)
        await until(lambda: "listener" in manager.configuration.instances)
        assert simulator.time.steady() - begun < 5
        first = words(manager, "outcome")[1]
        assert first.startswith("rolled_back: create talker"), "both were restarted together first"
        await asyncio.sleep(150)
        assert sorted(simulator.processes) == ["listener"]
        assert words(manager, "command").count("respawn listener") == 1
        assert (await crashed(manager)).container == "pipeline"
        [ended] = words(manager, "respawn_ended")
        assert "talker will not be restarted again" in ended

    run(body, tmp_path, specification)


def test_each_restart_waits_twice_as_long_as_the_one_before_until_none_is_left(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        delays = []
        for number in range(1, 6):
            await asyncio.sleep(RESTORED)
            assert "talker" in manager.configuration.instances
            begun = simulator.time.steady()
            await crash(simulator, "talker")
            found = await crashed(manager)
            assert found.respawn is not None and found.respawn.restarting and found.respawn.restarts == number
            assert found.respawn.words.endswith(f" s ({number} of 5 in 60 s)")
            await until(partial(restarted, manager, number))
            delays.append(simulator.time.steady() - begun)
        assert delays == pytest.approx([0.5, 1, 2, 3, 3], abs=0.05)
        await asyncio.sleep(RESTORED)
        await crash(simulator, "talker")
        await asyncio.sleep(150)
        found = await crashed(manager)
        assert found.respawn is not None and not found.respawn.restarting and found.respawn.seconds is None
        assert found.respawn.words == "it will not be restarted again: 5 restarts within 60 s did not help"
        assert found.remedy == "`midstride restart talker` restores it"
        assert words(manager, "respawn_ended") == [
            "talker exited unexpectedly; talker will not be restarted again: 5 restarts within 60 s did not help. "
            "`midstride logs talker` shows its output, `midstride restart talker` restores it"
        ]
        assert (await manager.why("listener.listen")).mode != "normal"

        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "done"
        await crash(simulator, "talker")  # a user's command has restored it: what was counted begins anew
        assert words(manager)[-1].endswith("restarting talker in 0.5 s (1 of 5 in 60 s)")

    run(body, tmp_path, respawning(RespawnPolicy(delay=0.5, max_delay=3.0)))


def test_a_node_that_never_starts_again_is_not_restarted_for_ever(tmp_path: Path) -> None:
    """Its starts take 20 s each, so that they are spread over more than the window: what counts is how long it ran."""
    program = tmp_path / "program.py"

    async def body(manager: Manager, simulator: Simulator) -> None:
        program.write_text("import time\ntime.sleep(20)\nraise SystemExit(7)")
        await crash(simulator, "talker")
        await asyncio.sleep(150)
        assert [line.rpartition("restarting ")[2] for line in words(manager)] == [
            "talker now (1 of 5 in 60 s)",
            "talker in 1.0 s (2 of 5 in 60 s)",
            "talker in 2.0 s (3 of 5 in 60 s)",
            "talker in 4.0 s (4 of 5 in 60 s)",
            "talker in 8.0 s (5 of 5 in 60 s)",
        ]
        assert words(manager)[1].startswith(
            "respawn talker failed: create talker (Talker): talker exited with status 7"
        )
        assert len(words(manager, "respawn_ended")) == 1
        found = await crashed(manager)
        assert found.name == "talker" and found.respawn is not None and not found.respawn.restarting
        assert (await manager.status()).valid

    run(body, tmp_path, programmed(respawning(RespawnPolicy()), "Talker", program))


def test_what_ran_for_longer_than_the_window_is_counted_anew(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        for _ in range(4):
            await crash(simulator, "talker")
            await asyncio.sleep(RESTORED)
            await asyncio.sleep(30)
        assert [line.rpartition(" (")[2] for line in words(manager)] == ["1 of 1 in 20 s)"] * 4

    run(body, tmp_path, respawning(RespawnPolicy(max_retries=1, window=20.0)))


def test_when_its_restarts_are_used_up_the_fallback_replaces_it_and_has_its_own(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        await asyncio.sleep(RESTORED)
        assert manager.configuration.component("talker").name == "Talker"
        await crash(simulator, "talker")
        await asyncio.sleep(RESTORED)
        assert words(manager)[-1] == (
            "talker exited unexpectedly; 1 restart within 60 s did not help: talker is replaced by NewTalker"
        )
        assert manager.configuration.component("talker").name == "NewTalker"
        assert manager.specification.nodes["talker"].component == "NewTalker"
        status = await manager.status()
        assert status.valid and status.crashed == []
        await crash(simulator, "talker")
        await asyncio.sleep(RESTORED)
        assert words(manager)[-1].endswith("restarting talker now (1 of 1 in 60 s)")
        assert manager.configuration.component("talker").name == "NewTalker"
        await crash(simulator, "talker")
        await asyncio.sleep(150)
        assert "talker" not in simulator.processes and len(words(manager, "respawn_ended")) == 1

    run(body, tmp_path, respawning(RespawnPolicy(max_retries=1, fallback="NewTalker")))


def test_a_fallback_that_does_not_start_is_left(tmp_path: Path) -> None:
    program = tmp_path / "program.py"

    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        await asyncio.sleep(150)
        [ended] = words(manager, "respawn_ended")
        assert ended.startswith("talker will not be restarted again: respawn talker as NewTalker failed")
        assert manager.specification.nodes["talker"].component == "Talker"
        assert (await crashed(manager)).name == "talker"

    policy = RespawnPolicy(max_retries=0, fallback="NewTalker")
    specification = programmed(respawning(policy), "NewTalker", program)
    program.write_text("raise SystemExit(7)")
    run(body, tmp_path, specification)


# -- with commands -------------------------------------------------------------------------------------


def test_a_command_that_restores_the_node_cancels_the_delay_and_the_count(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "done"
        pid = simulator.processes["talker"].pid
        await asyncio.sleep(100)
        assert simulator.processes["talker"].pid == pid
        assert words(manager)[-1] == "the restart of talker is cancelled: it runs again"
        await crash(simulator, "talker")
        assert words(manager)[-1].endswith("(1 of 5 in 60 s)")

    run(body, tmp_path, respawning(RespawnPolicy(delay=5.0)))


def test_a_command_that_fails_to_restore_it_leaves_the_delay_as_it_is(tmp_path: Path) -> None:
    program = tmp_path / "program.py"

    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        good = program.read_text()
        program.write_text("raise SystemExit(7)")
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "rolled_back"
        program.write_text(good)
        found = await crashed(manager)
        assert found.respawn is not None and found.respawn.seconds is not None and found.respawn.seconds < 5
        await asyncio.sleep(5 + RESTORED)
        assert (await manager.status()).valid and "talker" in simulator.processes
        assert len(words(manager)) == 1

    run(body, tmp_path, programmed(respawning(RespawnPolicy(delay=5.0)), "Talker", program))


@pytest.mark.parametrize("ends", ["remove", "down"])
def test_a_node_that_is_removed_or_taken_down_does_not_come_back(ends: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        if ends == "down":
            await crash(simulator, "talker")
            await manager.down()
        else:
            await manager.change(PlanRequest(remove=("talker",)))
            await manager.change(PlanRequest(add=(manager_node,)))
            await crash(simulator, "talker")
            await manager.change(PlanRequest(remove=("talker",)))
        await asyncio.sleep(150)
        assert "talker" not in simulator.processes
        assert words(manager, "command").count("respawn talker") == 0

    specification = respawning(RespawnPolicy(delay=5.0))
    manager_node = specification.nodes["talker"]
    run(body, tmp_path, specification)


def test_down_does_not_wait_for_a_restart_in_progress(tmp_path: Path) -> None:
    program = tmp_path / "program.py"

    async def body(manager: Manager, simulator: Simulator) -> None:
        program.write_text("import time\ntime.sleep(25)")
        simulator.faults.kill("talker")
        await asyncio.sleep(5)
        assert "talker" in simulator.processes and (await manager.status()).running is not None
        begun = simulator.time.steady()
        await manager.down()
        assert simulator.time.steady() - begun < 10
        await asyncio.sleep(150)
        assert not simulator.processes

    run(body, tmp_path, programmed(respawning(RespawnPolicy()), "Talker", program))


def test_a_policy_can_be_given_and_taken_away_without_touching_a_node(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        pid = simulator.processes["talker"].pid
        outcome = await manager.change(PlanRequest(to=respawning(RespawnPolicy(delay=5.0))))
        assert outcome.outcome == "done" and outcome.plan is not None and not outcome.plan.steps
        assert simulator.processes["talker"].pid == pid
        await crash(simulator, "talker")
        await asyncio.sleep(5 + RESTORED)
        assert (await manager.status()).valid
        await crash(simulator, "talker")
        assert (await crashed(manager)).respawn is not None
        assert (await manager.change(PlanRequest(to=example("talker")))).outcome == "done"  # restores it, too
        assert words(manager)[-1] == "the restart of talker is cancelled: it runs again"
        await crash(simulator, "talker")
        await asyncio.sleep(150)
        assert (await crashed(manager)).respawn is None

    run(body, tmp_path, example("talker"))


def test_a_restart_waits_for_the_command_in_progress(tmp_path: Path) -> None:
    """The source crashes while the filter is replaced; the change goes on, and the restart comes after it."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        change = asyncio.ensure_future(manager.change(replace("filter", "MedianFilter")))
        await asyncio.sleep(1)  # its new process is starting
        simulator.faults.kill("source")
        outcome = await change
        assert outcome.unexpected_exits == ["source"]
        await asyncio.sleep(RESTORED + 3)
        assert words(manager, "command")[1:] == ["replace filter with MedianFilter", "respawn source"]
        status = await manager.status()
        assert status.valid and status.crashed == [] and violations(manager.configuration) == []
        assert {role for role, found in manager.configuration.instances_by_role.items() if found} == {
            "source",
            "filter",
            "sink",
        }

    specification = respawning(RespawnPolicy(), "source", "filter")
    managed("filter", tmp_path, body, Simulator(starting=3.0), specification)


# -- crashes during a change ---------------------------------------------------------------------------


@pytest.mark.parametrize("victim", ["talker", "talker_2"])
def test_a_crash_of_the_old_or_new_component_is_the_changes_first(victim: str, tmp_path: Path) -> None:
    """The change ends, rolled back or done; a role that has no instance then is restarted."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        change = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        await until(lambda: any(e.step and e.step.action == "handover" for e in manager.log()))
        simulator.faults.kill(victim)
        await change
        await asyncio.sleep(RESTORED + 10)
        assert list(manager.configuration.instances_by_role["talker"])
        assert (await manager.status()).valid
        assert (await manager.why("listener.listen")).mode == "normal"

    run(body, tmp_path, respawning(RespawnPolicy()))


@pytest.mark.parametrize("starts", [True, False], ids=["done", "rolled back"])
def test_what_relies_on_a_component_that_crashes_during_a_change_of_others_is_degraded_at_once(
    starts: bool, tmp_path: Path
) -> None:
    """The change goes on, or is rolled back, without raising it again; it is restored with the crashed one."""
    program = tmp_path / "program.py"

    async def mode(manager: Manager) -> str:
        return (await manager.peek("listener")).functionalities["listen"].mode

    async def body(manager: Manager, simulator: Simulator) -> None:
        program.write_text("raise SystemExit(7)" if not starts else program.read_text())
        add = PlanRequest(add=(Node("second", "Talker"),))
        change = asyncio.ensure_future(manager.change(add))
        await asyncio.sleep(0.5)  # the new process is starting
        simulator.faults.kill("talker")
        await asyncio.sleep(0.05)
        assert not change.done() and await mode(manager) == "degraded"
        assert manager.configuration.component("talker").name == "Talker"  # the model follows at the end
        assert "degrade listener.listen from normal to degraded" in words(manager, "degraded")
        outcome = await change
        assert outcome.outcome == ("done" if starts else "rolled_back")
        assert outcome.unexpected_exits == ["talker"] and outcome.unexpected_degradations == []
        assert await mode(manager) == "degraded"
        assert violations(manager.configuration) == []
        program.write_text((EXAMPLES / "talker" / "talker.py").read_text())
        await asyncio.sleep(RESTORED + 5)
        assert (await manager.status()).valid and await mode(manager) == "normal"

    specification = programmed(respawning(RespawnPolicy(delay=1.0)), "Talker", program)
    run(body, tmp_path, specification, Simulator(starting=2.0))


def test_what_a_step_gives_other_support_is_raised_again(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        node = changed(manager.specification.nodes["talker"], role="second")
        change = asyncio.ensure_future(manager.change(PlanRequest(add=(node,))))
        await asyncio.sleep(0.5)
        simulator.faults.kill("talker")
        await asyncio.sleep(0.05)
        assert (await manager.peek("listener")).functionalities["listen"].mode == "degraded"
        assert (await change).outcome == "done"
        assert (await manager.peek("listener")).functionalities["listen"].mode == "normal"
        status = await manager.status()
        assert status.valid and [found.name for found in status.crashed] == ["talker"]

    run(body, tmp_path, example("talker"), Simulator(starting=2.0))


# -- with another manager --------------------------------------------------------------------------------


def test_the_next_manager_restores_what_the_last_one_was_going_to_and_counts_anew(tmp_path: Path) -> None:
    specification = respawning(RespawnPolicy(delay=5.0))
    simulator = Simulator()

    async def main() -> None:
        workspace = Workspace(tmp_path)
        manager = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        await manager.up()
        await crash(simulator, "talker")
        await manager.close()
        await asyncio.sleep(100)
        assert "talker" not in simulator.processes
        manager = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        await manager.up()
        try:
            assert (await manager.status()).valid and "talker" in simulator.processes
            await crash(simulator, "talker")
            assert words(manager)[-1].endswith("restarting talker in 5.0 s (1 of 5 in 60 s)")
            await asyncio.sleep(5 + RESTORED)
            assert (await manager.status()).valid
        finally:
            await manager.close()

    simulator.run(main())


def test_without_a_limit_it_is_restarted_for_ever_after_the_longest_delay(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        for number in range(1, 13):
            await asyncio.sleep(3)
            assert "talker" in manager.configuration.instances
            await crash(simulator, "talker")
            found = await crashed(manager)
            assert found.respawn is not None and (found.respawn.restarts, found.respawn.max_retries) == (number, None)
            assert found.respawn.words.endswith(f"(restart {number}, without a limit)")
            await until(partial(restarted, manager, number))

    run(body, tmp_path, respawning(RespawnPolicy(delay=0.5, max_delay=2.0, max_retries=None)))
