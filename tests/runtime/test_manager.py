"""The manager on the simulator: changes carried out, measured, queued, refused."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import BackendError, ManagerError, StepFailed
from midstride.model.component import StopTimes
from midstride.model.contract import DEFAULT_QOS
from midstride.model.rules import violations
from midstride.model.specification import Node
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Launch, RemainingProcess
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.records.reports import Event, Outcome
from midstride.runtime.records.status_forms import Why
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import RecordCommand
from tests.runtime.systems import EXAMPLES, example, kept, managed, replace, request, rewritten, saved

STRICT = SystemOptions(strict=True)
CHANGES = [("talker", "talker", "NewTalker"), ("obstacle", "detector", "StereoDetector")]
CHANGES += [("filter", "filter", "MedianFilter")]


@pytest.mark.parametrize(("name", "role", "component"), CHANGES)
def test_a_replacement_nobody_notices(name: str, role: str, component: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        await asyncio.sleep(1)  # until what is replaced has written: else nothing can be lost of it
        outcome = await manager.change(replace(role, component))
        assert violations(manager.configuration) == []
        assert sorted(simulator.processes) == sorted(manager.configuration.instances)
        assert manager.specification.nodes[role].component == component
        return outcome

    outcome = managed(name, tmp_path, body)
    assert (outcome.outcome, outcome.because, outcome.below_baseline_seconds) == ("done", None, {})
    assert outcome.swaps
    for swap in outcome.swaps:
        assert (swap.missed, swap.lost, swap.duplicates) == (0, 0, 0)
        # The filter's state moves in between: at 200 Hz, 1.5 ms are that many periods.
        assert swap.gap_periods == pytest.approx(1.3 if name == "filter" else 1.0, abs=0.05)


@pytest.mark.parametrize(("name", "role", "component"), CHANGES)
@pytest.mark.parametrize("strategy", ["paper", "quiesce", "stop"])
def test_the_other_strategies_end_in_the_same_place_and_say_what_they_cost(
    name: str, role: str, component: str, strategy: str, tmp_path: Path
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        outcome = await manager.change(replace(role, component, strategy))
        assert violations(manager.configuration) == []
        return outcome

    outcome = managed(name, tmp_path, body, Simulator(starting=0.5))
    assert outcome.outcome == "done"
    assert outcome.plan is not None
    assert set(outcome.below_baseline_seconds) == set(outcome.plan.degraded) and outcome.below_baseline_seconds
    assert all(seconds > 0 for seconds in outcome.below_baseline_seconds.values())
    assert all((swap.missed or 0) > 0 for swap in outcome.swaps)


def test_taking_the_detector_away_stops_the_motor_and_another_one_starts_it_again(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        assert (await manager.change(PlanRequest(remove=("detector",)))).outcome == "done"
        why = await manager.why("controller.control")
        assert why.mode == "degraded"
        assert any("/obstacles" in line and "no publisher" in line for line in why.chain)
        node = Node("detector", "StereoDetector", example("obstacle").nodes["detector"].attachments)
        assert (await manager.change(PlanRequest(add=(node,)))).outcome == "done"
        assert (await manager.why("controller.control")).mode == "normal"

    managed("obstacle", tmp_path, body)


def test_two_commands_at_once_run_one_after_the_other_and_the_second_is_told(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        first = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        await asyncio.sleep(0.01)
        second = asyncio.ensure_future(manager.change(replace("talker", "Talker")))
        outcomes = [await first, await second]
        assert [outcome.outcome for outcome in outcomes] == ["done", "done"]
        assert sorted(manager.configuration.instances) == ["listener", "talker_3"]
        waiting = [event.words for event in manager.log() if event.kind == "waiting"]
        assert waiting == ["`replace talker with Talker` waits for `replace talker with NewTalker`"]

    managed("talker", tmp_path, body)


def test_a_change_seen_at_an_older_revision_is_refused(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        seen = manager.revision
        await manager.change(replace("talker", "NewTalker"))
        return await manager.change(replace("talker", "Talker"), expected=seen)

    outcome = managed("talker", tmp_path, body)
    assert outcome.outcome == "refused" and "has changed since the plan was shown" in str(outcome.because)


@pytest.mark.parametrize(
    ("request_", "because"),
    [
        (replace("talker", "NewTalke"), "did you mean `NewTalker`?"),
        (replace("talkr", "NewTalker"), "did you mean `talker`?"),
        (replace("talker", "Listener"), "no port out"),
        (PlanRequest(), "the request is empty"),
        (replace("talker", "NewTalker", "fastest"), "fastest"),
    ],
)
def test_what_cannot_be_planned_is_refused_and_nothing_is_begun(
    request_: PlanRequest, because: str, tmp_path: Path
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        revision = manager.revision
        outcome = await manager.change(request_)
        assert manager.revision == revision and sorted(simulator.processes) == ["listener", "talker"]
        return outcome

    outcome = managed("talker", tmp_path, body)
    assert outcome.outcome == "refused" and because in str(outcome.because)


def test_a_crash_lowers_whom_it_must_and_the_next_plan_restores(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("detector")
        await asyncio.sleep(1)
        status = await manager.status()
        assert [entry.name for entry in status.crashed] == ["detector"]
        control = status.instances[0].functionalities[0]
        assert (control.name, control.mode) == ("control", "degraded")
        assert (await manager.change(PlanRequest(to=manager.specification))).outcome == "done"
        assert (await manager.why("controller.control")).mode == "normal"
        assert (await manager.status()).crashed == []
        assert (await manager.change(replace("detector", "StereoDetector"))).outcome == "done"
        simulator.faults.kill("detector_2")
        await asyncio.sleep(1)
        assert [entry.name for entry in (await manager.status()).crashed] == ["detector_2"]
        assert (await manager.change(PlanRequest(to=manager.specification))).outcome == "done"
        assert sorted(manager.configuration.instances) == ["controller", "detector"]
        assert (await manager.status()).crashed == []
        simulator.faults.kill("detector")
        await asyncio.sleep(1)
        assert (await manager.change(PlanRequest(remove=("detector",)))).outcome == "done"
        assert (await manager.status()).crashed == []

    managed("obstacle", tmp_path, body)


def test_a_crash_lowers_what_can_be_reached_and_later_the_others(tmp_path: Path) -> None:
    """The source is gone; the sink, which the filter feeds, does not answer. The filter is lowered all the same."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        life = manager.system.life
        life.adopted("sink", changed(life.handles["sink"], pid=4711))  # the simulator's have none
        simulator.faults.freeze("sink", 60)
        simulator.faults.kill("source")
        await asyncio.sleep(30)
        view = (await manager.peek("filter")).functionalities["smooth"]
        assert (view.mode, view.because) == ("degraded", "source exited unexpectedly")
        status = await manager.status()
        assert not status.valid, "the sink's mode is not known"
        (sink,) = [row for row in status.instances if row.name == "sink"]
        assert (sink.reachable, sink.pid) == (False, 4711), "the number is needed to kill it"
        await asyncio.sleep(60)
        assert (await manager.change(PlanRequest(remove=("filter",)))).outcome == "done"
        assert (await manager.peek("sink")).functionalities["use"].mode == "degraded"

    managed("filter", tmp_path, body)


async def replaced_while(
    manager: Manager, simulator: Simulator, kind: str, killed: str
) -> tuple[Outcome, Sequence[Event]]:
    """The talker is replaced, and ``killed`` dies at the first event of that kind: the outcome, and what happened."""
    begun = len(manager.log())
    change = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
    while not any(event.kind == kind for event in manager.log(begun)):
        await asyncio.sleep(0.001)
    simulator.faults.kill(killed)
    return await change, manager.log(begun)


def test_a_crash_while_a_change_is_measured_is_told_and_does_not_wait_for_that(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        outcome, events = await replaced_while(manager, simulator, "measuring", "talker_2")
        assert (outcome.outcome, outcome.unexpected_exits) == ("done", ["talker_2"])
        kinds = [event.kind for event in events]
        assert kinds.index("degraded") < kinds.index("measured")
        view = (await manager.peek("listener")).functionalities["listen"]
        assert (view.mode, view.because.endswith("exited unexpectedly")) == ("degraded", True)
        assert [entry.name for entry in (await manager.status()).crashed] == ["talker_2"]

    managed("talker", tmp_path, body)


def test_a_component_that_dies_while_it_is_being_replaced_is_replaced(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        outcome, _ = await replaced_while(manager, simulator, "step", "talker")
        assert (outcome.outcome, outcome.unexpected_exits, outcome.unexpected_degradations) == ("done", ["talker"], [])
        assert (await manager.peek("listener")).functionalities["listen"].mode == "normal"
        assert (await manager.status()).crashed == []

    managed("talker", tmp_path, body)


def test_a_crash_at_the_very_end_of_a_command_is_seen_to(tmp_path: Path) -> None:
    """While the manager looks whether anybody has fallen meanwhile, the last thing it does, the detector dies."""

    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> None:
        reconciler = manager._reconciler
        reconcile, looks = reconciler.reconcile, 0

        async def late() -> None:
            nonlocal looks
            looks += 1
            await reconcile()
            if looks == 2:
                simulator.faults.kill("detector")
                await asyncio.sleep(0.1)

        reconciler.reconcile = late  # type: ignore[method-assign]
        assert (await manager.change(PlanRequest())).outcome == "refused"
        reconciler.reconcile = reconcile  # type: ignore[method-assign]
        await asyncio.sleep(2)
        assert sorted(manager.configuration.instances) == ["controller"]
        assert (await manager.peek("controller")).functionalities["control"].mode == "degraded"

    managed("obstacle", tmp_path, body, simulator)


def test_at_no_call_does_a_process_run_that_the_next_manager_would_not_know(tmp_path: Path) -> None:
    simulator, looks = Simulator(), 0

    async def look(instance: str, op: str) -> None:
        nonlocal looks
        looks += 1
        instances = saved(Workspace(tmp_path)).instances
        assert set(simulator.processes) <= {entry.instance.name for entry in instances if entry.handle}

    simulator.control.before_request = look

    async def body(manager: Manager, _: Simulator) -> None:
        assert (await manager.change(replace("talker", "NewTalker"))).outcome == "done"

    managed("talker", tmp_path, body, simulator)
    assert looks > 20


def test_a_component_started_by_hand_is_taken_in_found_again_and_left_running(tmp_path: Path) -> None:
    specification = example("talker")
    by_hand = changed(specification.components["Talker"], run=None)
    specification = changed(specification, components=specification.components.set("Talker", by_hand))
    simulator = Simulator()

    async def main() -> None:
        launch = Launch("talker", "", ("python3", "talker.py"), "", EXAMPLES / "talker")
        await simulator.start(launch)
        first = Manager(specification, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        assert (await first.up()).instances == ["listener", "talker"]
        assert (await first.status()).valid
        await first.close()
        second = Manager(specification, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        assert (await second.up()).instances == ["listener", "talker"]
        await second.down()
        words = [event.words for event in second.log()]
        assert "talker was started elsewhere: it is released, and left running" in words
        assert list(simulator.processes) == ["talker"] and not (await simulator.endpoints()).publishers
        await second.close()
        third = Manager(specification, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        assert (await third.up()).instances == ["listener", "talker"]
        outcome = await third.change(replace("talker", "NewTalker"))
        assert outcome.outcome == "done" and outcome.swaps[0].missed == 0
        assert sorted(third.configuration.instances) == ["listener", "talker_2"]
        assert sorted(simulator.processes) == ["listener", "talker", "talker_2"]
        await third.close()

    simulator.run(main())


def test_a_component_started_by_hand_that_ends_is_noticed_at_once_and_accepted_again(tmp_path: Path) -> None:
    specification = example("talker")
    by_hand = changed(specification.components["Talker"], run=None)
    specification = changed(specification, components=specification.components.set("Talker", by_hand))
    simulator = Simulator()
    launch = Launch("talker", "", ("python3", "talker.py"), "", EXAMPLES / "talker")

    async def main() -> None:
        await simulator.start(launch)
        manager = Manager(specification, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await manager.up()
        simulator.faults.kill("talker")
        await asyncio.sleep(1)
        status = await manager.status()
        assert [each.name for each in status.crashed] == ["talker"] and status.valid
        assert (await manager.peek("listener")).functionalities["listen"].mode == "degraded"
        await simulator.start(launch)
        await asyncio.sleep(1)
        ended = [event.words for event in manager.log() if event.kind == "exited"]
        assert ended == ["talker exited unexpectedly"] and list(manager.configuration.instances) == ["listener"]
        assert (await manager.change(PlanRequest(to=specification))).outcome == "done"
        assert (await manager.status()).valid and "talker" in manager.configuration.instances
        simulator.faults.kill("talker")
        await asyncio.sleep(1)
        await manager.down()
        assert not simulator.processes
        await manager.close()

    simulator.run(main())


def test_the_next_manager_finds_everything_again(tmp_path: Path) -> None:
    simulator = Simulator()

    async def main() -> None:
        first = Manager(example("talker"), simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await first.up()
        await first.change(replace("talker", "NewTalker"))
        changed = first.specification
        await first.close()
        pids = {name: process.pid for name, process in simulator.processes.items()}
        second = Manager(changed, simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await second.up()
        assert {name: process.pid for name, process in simulator.processes.items()} == pids
        assert second.configuration == first.configuration
        assert (await second.change(replace("talker", "Talker"))).outcome == "done"
        await second.down()
        assert not simulator.processes and not Workspace(tmp_path).state.exists()
        await second.close()

    simulator.run(main())


def test_a_manager_that_is_closed_notes_no_more_exits(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await manager.close()
        before = manager.log()
        simulator.faults.kill("talker")
        await asyncio.sleep(1)
        assert manager.log() == before

    managed("talker", tmp_path, body)


def test_the_next_manager_ends_a_recording_that_a_killed_one_has_left(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        workspace = Workspace(tmp_path)
        revision = (await manager.peek("listener")).revision
        left = RecordCommand(inputs=["in"], on=True)
        assert (await request(workspace, simulator, "listener", left, revision)).ok
        await manager.close()
        following = Manager(example("talker"), simulator, workspace, EXAMPLES / "talker")
        await following.up()
        await asyncio.sleep(10)
        assert await kept(workspace, simulator, "listener.in") == 64
        await following.close()

    managed("talker", tmp_path, body)


def test_another_specification_does_not_take_over_a_running_system(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await manager.close()
        other = example("talker").with_replaced("talker", "NewTalker")
        with pytest.raises(ManagerError, match="midstride apply"):
            await Manager(other, simulator, Workspace(tmp_path), EXAMPLES / "talker").up()

    managed("talker", tmp_path, body)


@pytest.mark.parametrize(
    ("program", "because"),
    [
        ("raise RuntimeError('no camera')", "no camera"),
        ("import nowhere", "No module named 'nowhere'"),
        ("pass", "exited with status 0 before it registered"),
        ("import sys; sys.exit(3)", "exited with status 3 before it registered"),
        ("import time\nwhile True: time.sleep(1)", "did not register within 30 s"),
        (
            "from midstride import Component\nfrom std_msgs.msg import String\nc = Component('x')\n"
            "o = c.create_output('other', String)\nf = c.create_functionality('talk', outputs=[o])\n"
            "f.set_normal_mode(lambda: None, rate=10, outputs=[o])\nf.set_degraded_mode(lambda: None)\nc.start()",
            "output out is declared, but the node does not have it",
        ),
    ],
)
def test_a_component_that_does_not_come_is_named_and_the_rest_goes_on(
    program: str, because: str, tmp_path: Path
) -> None:
    script = tmp_path / "broken.py"
    script.write_text(program)
    specification = example("talker")
    broken = changed(specification.components["NewTalker"], run=f"python3 {script}")
    specification = changed(specification, components=specification.components.set("NewTalker", broken))

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert sorted(simulator.processes) == ["listener", "talker"]
        assert violations(manager.configuration) == []
        return outcome

    folder = tmp_path / "workspace"
    folder.mkdir()
    outcome = managed("talker", folder, body, specification=specification)
    assert outcome.outcome == "rolled_back"
    assert "talker_2" in str(outcome.because) and because in str(outcome.because)


def test_what_relies_on_a_component_that_has_degraded_by_itself_is_lowered_at_once(tmp_path: Path) -> None:
    """The talker's code raises after a while; nobody gives a command."""
    script = tmp_path / "breaking.py"
    program = (EXAMPLES / "talker" / "talker.py").read_text(encoding="utf-8")
    script.write_text(
        program.replace(
            "def normal() -> None:\n",
            "calls = 0\n\n\ndef normal() -> None:\n    global calls\n    calls += 1\n    1 / (calls - 30)\n",
        )
    )
    specification = example("talker")
    breaking = changed(specification.components["Talker"], run=f"python3 {script}")
    specification = changed(specification, components=specification.components.set("Talker", breaking))

    async def body(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(10)
        view = (await manager.peek("listener")).functionalities["listen"]
        assert (view.mode, view.because) == ("degraded", "talker.talk entered mode degraded unexpectedly")
        assert view.because in [event.words for event in manager.log() if event.kind == "degraded"]
        state = await manager.status()
        assert state.valid and not state.topics[0].satisfied
        again = await manager.change(PlanRequest(to=specification))
        assert (again.outcome, again.because) == ("done", None), "it raises no more"
        assert await modes(manager) == {"talker.talk": "normal", "listener.listen": "normal"}

    async def modes(manager: Manager) -> dict[str, str]:
        instances = (await manager.status()).instances
        return {f"{each.name}.{row.name}": row.mode for each in instances for row in each.functionalities}

    folder = tmp_path / "workspace"
    folder.mkdir()
    managed("talker", folder, body, specification=specification)


def test_a_strict_system_that_does_not_come_up_leaves_nothing_running(tmp_path: Path) -> None:
    script = tmp_path / "broken.py"
    script.write_text("raise RuntimeError('no camera')")
    specification = example("talker")
    broken = changed(specification.components["Talker"], run=f"python3 {script}")
    specification = changed(specification, components=specification.components.set("Talker", broken))
    simulator = Simulator()

    async def main() -> None:
        manager = Manager(specification, simulator, Workspace(tmp_path), EXAMPLES / "talker", options=STRICT)
        with pytest.raises(StepFailed, match="no camera"):
            await manager.up()
        assert not simulator.processes
        assert not Workspace(tmp_path).state.exists()
        await manager.close()

    simulator.run(main())


def test_a_strict_system_that_does_not_come_up_and_cannot_be_taken_back_is_not_forgotten(tmp_path: Path) -> None:
    class Stuck(Simulator):
        async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
            if instance in self.processes:
                raise BackendError(f"the kernel does not let go of {instance}")
            return []

    (tmp_path / "broken.py").write_text("raise RuntimeError('no camera')")
    specification = example("talker")
    broken = changed(specification.components["Talker"], run=f"python3 {tmp_path}/broken.py")
    specification = changed(specification, components=specification.components.set("Talker", broken))
    simulator = Stuck()

    async def main() -> None:
        manager = Manager(specification, simulator, Workspace(tmp_path), EXAMPLES / "talker", options=STRICT)
        with pytest.raises(StepFailed, match="does not let go of listener"):
            await manager.up()
        assert list(simulator.processes) == ["listener"]
        instances = saved(Workspace(tmp_path)).instances
        assert [entry.instance.name for entry in instances if entry.handle] == ["listener"]
        await manager.close()

    simulator.run(main())


@pytest.mark.parametrize("after", [0.0, 0.03, 0.06, 0.09])
def test_a_manager_told_to_end_while_the_system_comes_up_leaves_nothing(after: float, tmp_path: Path) -> None:
    simulator = Simulator()

    async def main() -> None:
        manager = Manager(example("talker"), simulator, Workspace(tmp_path), EXAMPLES / "talker")
        coming = asyncio.ensure_future(manager.up())
        await asyncio.sleep(after)
        coming.cancel()
        await asyncio.wait({coming})
        assert coming.cancelled(), "it was up before: the test missed what it is about"
        assert not simulator.processes and not Workspace(tmp_path).state.exists()
        await manager.close()

    simulator.run(main())


def test_a_component_has_the_time_to_stop_that_its_author_asked_for(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(
        "from midstride import Component\nfrom std_msgs.msg import String\nc = Component('talker')\n"
        "o = c.create_output('out', String)\nf = c.create_functionality('talk', outputs=[o])\n"
        "f.set_normal_mode(lambda: o.write(String(data='')), rate=10, outputs=[o])\n"
        "f.set_degraded_mode(lambda: None)\n"
        "async def stop():\n    await c.clock.sleep(6)\n    print('stopped in order')\n"
        "c.on_stop(stop, timeout=8)\nc.start()"
    )
    specification = example("talker")
    slow = changed(specification.components["Talker"], run=f"python3 {tmp_path}/slow.py")
    specification = changed(specification, components=specification.components.set("Talker", slow))

    async def body(manager: Manager, simulator: Simulator) -> None:
        log = simulator.processes["talker"].log
        await manager.close()
        following = Manager(specification, simulator, Workspace(folder), EXAMPLES / "talker")
        await following.up()
        await following.down()
        assert not simulator.processes and "stopped in order" in log.tail()

    folder = tmp_path / "workspace"
    folder.mkdir()
    managed("talker", folder, body, specification=specification)


def test_processes_that_do_not_end_in_order_are_named_by_event_report_and_down(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(
        "from midstride import Component\nfrom std_msgs.msg import String\nc = Component('talker')\n"
        "o = c.create_output('out', String)\nf = c.create_functionality('talk', outputs=[o])\n"
        "f.set_normal_mode(lambda: o.write(String(data='')), rate=10, outputs=[o])\n"
        "f.set_degraded_mode(lambda: None)\n"
        "import time\ndef stop():\n    time.sleep(60)\n"
        "c.on_stop(stop, timeout=4)\nc.start()"
    )
    specification = example("talker")
    slow = changed(specification.components["Talker"], run=f"python3 {tmp_path}/slow.py")
    specification = changed(specification, components=specification.components.set("Talker", slow))

    async def body(manager: Manager, _: Simulator) -> None:
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        (killed,) = outcome.killed
        assert outcome.outcome == "done" and killed.instance == "talker" and killed.seconds > 4
        assert (
            killed.words == f"talker had not ended {killed.seconds:g} s after it was asked to, and was killed (SIGKILL)"
        )
        assert [event.words for event in manager.log() if event.kind == "killed"] == [killed.words]
        assert outcome.continuity is not None and f"{killed.words}: what it does at its end is lost" in [
            each.words for each in outcome.continuity.found
        ]
        assert [each.instance for each in (await manager.down()).killed] == ["talker_2"]

    managed("talker", tmp_path, body, specification=specification)


@pytest.mark.parametrize(
    ("stop", "words"),
    [
        ("async def stop():\n    await c.clock.sleep(60)\n", "on_stop did not return within 4 s"),
        ("def stop():\n    raise ValueError('no disk')\n", "on_stop raised ValueError: no disk"),
    ],
)
def test_an_on_stop_that_fails_is_named_by_the_report(stop: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "failing.py").write_text(
        "from midstride import Component\nfrom std_msgs.msg import String\nc = Component('talker')\n"
        "o = c.create_output('out', String)\nf = c.create_functionality('talk', outputs=[o])\n"
        "f.set_normal_mode(lambda: o.write(String(data='')), rate=10, outputs=[o])\n"
        f"f.set_degraded_mode(lambda: None)\n{stop}c.on_stop(stop, timeout=4)\nc.start()"
    )
    specification = example("talker")
    failing = changed(specification.components["Talker"], run=f"python3 {tmp_path}/failing.py")
    specification = changed(specification, components=specification.components.set("Talker", failing))

    async def body(manager: Manager, _: Simulator) -> None:
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        said = f"talker: {words}: what it does at its end is lost"
        assert outcome.outcome == "done"
        assert [(each.words, each.unfinished) for each in outcome.killed] == [(said, True)]
        assert outcome.continuity is not None and outcome.continuity.headline.count("is lost") == 1
        assert said in outcome.continuity.headline

    managed("talker", tmp_path, body, specification=specification)


def test_what_has_degraded_by_itself_is_raised_again_at_the_first_try(tmp_path: Path) -> None:
    """It has moved on by that, which the manager has seen: no reason to refuse the change that mends it."""

    def glitching(file: str, text: str) -> str:
        if file != "talker.py":
            return text
        text = text.replace("def normal() -> None:\n", "calls = []\n\n\ndef normal():\n    calls.append(0)\n")
        glitch = "    if len(calls) == 20:\n        raise ValueError('a glitch')\n"
        return text.replace("    out.write(", glitch + "    out.write(")

    async def body(manager: Manager, _: Simulator) -> tuple[Outcome, Why]:
        await asyncio.sleep(5)
        assert (await manager.why("talker.talk")).mode == "degraded"
        outcome = await manager.change(PlanRequest(to=example("talker")))
        return outcome, await manager.why("listener.listen")

    programs = rewritten("talker", tmp_path / "programs", glitching)
    outcome, listening = managed("talker", tmp_path, body, directory=programs)
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert listening.mode == "normal"


@pytest.mark.parametrize(("after", "told"), [(2.0, 0), (60.0, 1)], ids=["late", "never"])
def test_a_hand_over_waits_for_readers_that_are_not_of_the_system(
    after: float, told: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`ros2 topic echo`, a recording: a process with the middleware's own defaults finds new publishers late."""
    simulator = Simulator()
    network = simulator.network
    matched = network.readers_of

    async def body(manager: Manager, _: Simulator) -> tuple[Outcome, list[str]]:
        foreign = network.create_reader(
            simulator.processes["listener"], "/chatter", "std_msgs/msg/String", DEFAULT_QOS, lambda: None
        )
        await asyncio.sleep(1)
        begun = simulator.clock.steady()

        def slowly(writer: Any) -> Any:
            found = matched(writer)
            known = writer.created < begun or simulator.clock.steady() >= writer.created + after
            return [reader for reader in found if reader is not foreign or known]

        monkeypatch.setattr(network, "readers_of", slowly)
        outcome = await manager.change(replace("talker", "NewTalker"))
        foreign.destroy()
        return outcome, [event.words for event in manager.log() if "outside this system" in event.words]

    outcome, notes = managed("talker", tmp_path, body, simulator)
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert outcome.seconds > min(after, 4.0)
    assert len(notes) == told
    assert outcome.swaps[0].missed == 0


def test_a_new_one_that_breaks_while_it_is_watched_is_in_the_outcome(tmp_path: Path) -> None:
    def breaking(file: str, text: str) -> str:
        if file != "new_talker.py":
            return text
        text = text.replace("    out.write(", "    calls.append(0)\n    1 / (len(calls) < 25)\n    out.write(", 1)
        return text.replace("talk.set_normal_mode(", "calls = []\ntalk.set_normal_mode(")

    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(replace("talker", "NewTalker"))

    outcome = managed("talker", tmp_path, body, directory=rewritten("talker", tmp_path / "programs", breaking))
    assert (outcome.outcome, outcome.because, outcome.unexpected_exits) == ("done", None, [])
    assert outcome.unexpected_degradations == ["talker_2.talk"]


def test_what_could_not_be_undone_is_taken_over_as_the_component_reports_it(tmp_path: Path) -> None:
    """The talker detaches its output, but its replies get lost, and the manager cannot reach it to undo that."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.fail_next("talker", "detach", "lost_reply", times=2)
        simulator.faults.fail_next("talker", "attach", "unreachable")
        outcome = await manager.change(replace("talker", "NewTalker", "paper"))
        assert outcome.outcome == "rolled_back"
        assert "talker.out is not attached to /chatter any more, by its own report" in [
            event.words for event in manager.log()
        ]
        assert (await manager.why("listener.listen")).mode == "degraded"
        assert all(row.as_modelled for row in (await manager.status()).instances)
        assert (await manager.change(PlanRequest(to=manager.specification))).outcome == "done"
        assert (await manager.why("listener.listen")).mode == "normal"

    managed("talker", tmp_path, body)


def test_a_component_that_refuses_to_be_degraded_is_asked_again(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.fail_next("controller", "modes", "refused")
        simulator.faults.kill("detector")
        await asyncio.sleep(2)
        assert (await manager.peek("controller")).functionalities["control"].mode == "degraded"

    managed("obstacle", tmp_path, body)
