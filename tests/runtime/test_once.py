"""Programs that end (`once`): they run after the others, their success is stored, and nothing runs them again."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import StepFailed, Unreachable
from midstride.model.component import ComponentSpec
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Node, Order, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.pending_starts import ONCE_TIMEOUT
from midstride.runtime.records.reports import UpReport
from midstride.runtime.workspace import Workspace
from tests.planting import plant
from tests.runtime.systems import example, rewritten, saved, up

# Says in a file that it runs, and with which argument.
PROGRAM = """
import sys, time
from pathlib import Path
with open(Path(__file__).with_suffix(".runs"), "a") as file:
    file.write(sys.argv[1] + "\\n")
time.sleep(0.5)
"""
Body = Callable[[Manager, Simulator, UpReport], Awaitable[None]]


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    folder = rewritten("talker", tmp_path / "programs", lambda _, text: text)
    (folder / "setup.py").write_text(PROGRAM)
    return folder


def runs(programs: Path) -> list[str]:
    """The arguments of the runs so far."""
    file = programs / "setup.runs"
    return file.read_text().split() if file.exists() else []


def setup(argument: str = "first", startup_seconds: float | None = None) -> ComponentSpec:
    command = f"python3 setup.py {argument}"
    return ComponentSpec.of("Setup", run=command, once=True, gate="none", startup_seconds=startup_seconds)


def system(programs: Path, component: ComponentSpec | None = None, node: Node | None = None) -> Specification:
    """The talker's example with the program `setup`."""
    specification = example("talker", programs)
    components = specification.components.set("Setup", component or setup())
    return changed(specification, components=components).with_node(node or Node("setup", "Setup"))


def with_setup(specification: Specification, argument: str) -> Specification:
    return changed(specification, components=specification.components.set("Setup", setup(argument)))


def steps(manager: Manager) -> list[str]:
    """The steps of the last plan, by action and role."""
    plan = [event.plan for event in manager.log() if event.plan][-1]
    return [f"{each.action} {getattr(each, 'role', '') or getattr(each, 'instance', '')}" for each in plan.steps]


def test_it_runs_after_all_others_and_is_done(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances, report.degraded) == ("done", ["listener", "setup", "talker"], [])
        assert runs(programs) == ["first"]
        assert sorted(simulator.processes) == ["listener", "talker"]
        assert steps(manager)[-1] == "create setup" and len(steps(manager)) == 7
        await asyncio.sleep(10)
        status = await manager.status()
        assert status.valid and status.crashed == [] and status.silences == []
        assert (status.condition.state, status.condition.headline) == ("up", "up, all 3 nodes run")
        [found] = [each for each in status.instances if each.name == "setup"]
        assert (found.done, found.reachable, found.deviation, found.pid) == (True, False, None, None)
        assert [each.kind for each in manager.log() if each.kind in {"exited", "silence"}] == []
        assert [each.name for each in await manager.programs()] == ["listener", "talker"]
        [entry] = [each for each in saved(Workspace(tmp_path)).instances if each.instance.name == "setup"]
        assert entry.done and entry.handle is None
        await manager.down()
        assert simulator.processes == {}

    up(system(programs), tmp_path, programs, body)


def test_an_order_puts_it_before_the_others(tmp_path: Path, programs: Path) -> None:
    constraints = (Order("setup", "talker"),)

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert report.outcome == "done"
        assert steps(manager).index("create setup") < steps(manager).index("create talker")

    up(changed(system(programs), constraints=constraints), tmp_path, programs, body)


def test_no_change_and_no_manager_runs_it_again(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        specification = manager.specification
        for request in (
            PlanRequest(restart=("talker",)),
            PlanRequest(to=specification),
            PlanRequest(replace=(("talker", "NewTalker"),)),
            PlanRequest(to=specification),
            PlanRequest(restart=("talker",), strategy="stop"),
        ):
            outcome = await manager.change(request)
            assert outcome.outcome == "done", outcome.because
        simulator.faults.kill(manager.configuration.instances_of("listener")[0].name)
        await asyncio.sleep(1)
        await manager.close()
        simulator.faults.kill(manager.configuration.instances_of("talker")[0].name)
        second = Manager(specification, simulator, Workspace(tmp_path), programs)
        again = await second.up()
        assert (again.outcome, again.degraded) == ("done", [])
        assert "setup" in again.instances and runs(programs) == ["first"]
        assert (await second.status()).valid and second.system.life.is_done("setup")
        await second.close()

    up(system(programs), tmp_path, programs, body)


def test_it_runs_again_when_its_command_changes_or_it_is_named(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        named = await manager.change(PlanRequest(restart=("setup",)))
        assert (named.outcome, runs(programs)) == ("done", ["first", "first"]), named.because
        assert sorted(manager.configuration.instances) == ["listener", "setup_2", "talker"]
        other = with_setup(manager.specification, "second")
        applied = await manager.change(PlanRequest(to=other))
        assert (applied.outcome, runs(programs)) == ("done", ["first", "first", "second"]), applied.because
        assert len(manager.configuration.instances_of("setup")) == 1
        removed = await manager.change(PlanRequest(remove=("setup",)))
        assert (removed.outcome, sorted(manager.configuration.instances)) == ("done", ["listener", "talker"])
        assert [each.instance.name for each in saved(Workspace(tmp_path)).instances] == ["listener", "talker"]

    up(system(programs), tmp_path, programs, body)


def test_a_roll_back_does_not_run_it_again(tmp_path: Path, programs: Path) -> None:
    """The new program fails after the old one's work was done, or another part of the change does."""

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        failing = with_setup(manager.specification, "second")
        (programs / "setup.py").write_text(PROGRAM + "raise SystemExit('no arm')\n")
        outcome = await manager.change(PlanRequest(to=failing))
        assert outcome.outcome == "rolled_back" and "setup_2 exited with status 1 with its work not done" in str(
            outcome.because
        )
        assert runs(programs) == ["first", "second"]
        assert sorted(manager.configuration.instances) == ["listener", "setup", "talker"]
        assert manager.system.life.is_done("setup") and (await manager.status()).valid
        [entry] = [each for each in saved(Workspace(tmp_path)).instances if each.instance.role == "setup"]
        assert entry.done and entry.instance.name == "setup"
        # Removed, and another part fails: it is done again without a run.
        without = manager.specification.without_node("setup")
        without = changed(without, constraints=(*without.constraints, Order("setup", "talker")))
        broken = changed(without.components["Talker"], run="python3 broken.py")
        (programs / "broken.py").write_text("raise SystemExit(1)\n")
        outcome = await manager.change(
            PlanRequest(to=changed(without, components=without.components.set("Talker", broken), constraints=()))
        )
        assert outcome.outcome == "rolled_back"
        assert manager.system.life.is_done("setup") and runs(programs) == ["first", "second"]

    up(system(programs), tmp_path, programs, body)


def test_a_failure_is_that_of_a_node_and_follows_respawn(tmp_path: Path, programs: Path) -> None:
    (programs / "setup.py").write_text(PROGRAM + "raise SystemExit('no arm')\n")
    node = Node("setup", "Setup", respawn=RespawnPolicy(delay=1.0))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances) == ("incomplete", ["listener", "talker"])
        assert report.missing["setup"].startswith("setup exited with status 1 with its work not done:\nno arm")
        [crashed] = (await manager.status()).crashed
        assert (crashed.role, crashed.status, crashed.respawn is not None) == ("setup", 1, True)
        await asyncio.sleep(3)
        (programs / "setup.py").write_text(PROGRAM)
        await asyncio.sleep(10)
        assert (await manager.status()).crashed == [] and manager.system.life.is_done("setup")
        before = len(runs(programs))
        await asyncio.sleep(100)
        assert before == len(runs(programs)) >= 3

    up(system(programs, node=node), tmp_path, programs, body)


def test_one_that_keeps_running_fails_after_a_stated_time(tmp_path: Path, programs: Path) -> None:
    (programs / "setup.py").write_text(HANGS)

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert report.missing["setup"].startswith("setup has not ended within 70 s")
        assert ONCE_TIMEOUT + 10 <= simulator.clock.steady() < ONCE_TIMEOUT + 20
        assert "setup" not in simulator.processes

    up(system(programs, setup(startup_seconds=10.0)), tmp_path, programs, body)


def test_strict_takes_it_for_one_of_the_nodes(tmp_path: Path, programs: Path) -> None:
    (programs / "setup.py").write_text("raise SystemExit('no arm')\n")

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        raise AssertionError

    with pytest.raises(StepFailed, match="no arm"):
        up(system(programs), tmp_path, programs, body, SystemOptions(strict=True))


async def die(manager: Manager, command: Coroutine[Any, Any, object], instance: str, simulator: Simulator) -> None:
    """Begin ``command``, and have the manager do nothing more, as if killed, while the program of ``instance`` runs."""

    async def dead(*_: object, **__: object) -> None:
        raise Unreachable("the manager has been killed")

    running = asyncio.ensure_future(command)
    while instance not in simulator.processes:
        await asyncio.sleep(0.01)
    await asyncio.sleep(1)
    manager._launcher.end = manager._launcher.kill = manager._launcher.abandon = dead  # type: ignore[method-assign]
    for name in ("write_instance", "remove_instance", "delete"):
        plant(pytest.MonkeyPatch(), manager._store, name, lambda *_, **__: None)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    await manager.close()


HANGS = "import time\nwhile True:\n    time.sleep(1)\n"


def seen_at(seconds: float, found: list[tuple[list[str], list[str]]], programs: Path) -> Callable[[Simulator], None]:
    """Note which processes run, and which programs have, in so many seconds."""

    def look(simulator: Simulator) -> None:
        found.append((sorted(simulator.processes), runs(programs)))

    def prepare(simulator: Simulator) -> None:
        simulator.time.loop.call_later(seconds, look, simulator)

    return prepare


def with_last(specification: Specification) -> Specification:
    """The same with a program that runs last."""
    component = changed(setup("last"), name="Last", run="python3 last.py last")
    specification = changed(specification, components=specification.components.set("Last", component))
    return specification.with_node(Node("last", "Last"))


def test_one_that_hangs_delays_only_what_waits_for_it(tmp_path: Path, programs: Path) -> None:
    found: list[tuple[list[str], list[str]]] = []
    (programs / "setup.py").write_text(HANGS)

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert found == [(["listener", "setup"], [])]
        assert list(report.missing) == ["setup"] and "setup has not ended within 60 s" in report.missing["setup"]
        assert sorted(simulator.processes) == ["listener", "talker"] == report.instances
        assert ONCE_TIMEOUT <= simulator.clock.steady() < ONCE_TIMEOUT + 5
        assert (await manager.status()).violations == []

    specification = changed(system(programs), constraints=(Order("setup", "talker"),))
    up(specification, tmp_path, programs, body, prepare=seen_at(5.0, found, programs))


@pytest.mark.parametrize("fails", [False, True])
def test_one_that_takes_long_is_run_once_and_the_last_one_after_what_waits_for_it(
    fails: bool, tmp_path: Path, programs: Path
) -> None:
    found: list[tuple[list[str], list[str]]] = []
    (programs / "setup.py").write_text(PROGRAM.replace("0.5", "20") + ("raise SystemExit('no arm')\n" if fails else ""))
    (programs / "last.py").write_text(PROGRAM.replace("(__file__)", "(__file__).with_name('setup.py')"))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert found == [(["listener", "setup"], ["first"])]
        assert list(report.missing) == (["setup"] if fails else [])
        assert runs(programs) == ["first", "last"]
        done = ["last"] if fails else ["last", "setup"]
        assert [name for name in ("last", "setup") if manager.system.life.is_done(name)] == done
        assert sorted(simulator.processes) == ["listener", "talker"]
        assert 20 < simulator.clock.steady() < 25
        begun = [each.words.partition(" ")[2] for each in manager.log() if each.kind == "step"]
        assert begun.index("create talker (Talker)") < begun.index("create last (Last)")

    specification = changed(with_last(system(programs)), constraints=(Order("setup", "talker"),))
    up(specification, tmp_path, programs, body, prepare=seen_at(5.0, found, programs))


def test_the_last_one_runs_when_a_node_that_takes_long_is_up(tmp_path: Path, programs: Path) -> None:
    found: list[tuple[list[str], list[str]]] = []
    talker = programs / "talker.py"
    talker.write_text("import time\ntime.sleep(20)\n" + talker.read_text())

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert found == [(["listener", "talker"], [])]
        assert (report.outcome, report.missing, runs(programs)) == ("done", {}, ["first"])

    up(system(programs), tmp_path, programs, body, prepare=seen_at(15.0, found, programs))


@pytest.mark.parametrize("of", ["a change", "the first up"])
def test_a_manager_that_dies_while_it_runs_leaves_it_undone(of: str, tmp_path: Path, programs: Path) -> None:
    """The next one ends what is left of it; whether it had succeeded is not known."""
    slow, simulator = PROGRAM.replace("0.5", "30"), Simulator()

    async def main() -> None:
        first = Manager(system(programs), simulator, Workspace(tmp_path), programs)
        if of == "a change":
            await first.up()
            (programs / "setup.py").write_text(slow)
            await die(first, first.change(PlanRequest(restart=("setup",))), "setup_2", simulator)
            kept = [("setup", True), ("setup_2", False)]
        else:
            (programs / "setup.py").write_text(slow)
            await die(first, first.up(), "setup", simulator)
            kept = [("setup", False)]
        entries = [each for each in saved(Workspace(tmp_path)).instances if each.instance.role == "setup"]
        assert [(each.instance.name, each.done) for each in entries] == kept
        assert kept[-1][0] in simulator.processes
        (programs / "setup.py").write_text(PROGRAM)
        second = Manager(first.specification, simulator, Workspace(tmp_path), programs)
        report = await second.up()
        assert (report.outcome, sorted(simulator.processes)) == ("done", ["listener", "talker"])
        assert second.system.life.is_done("setup") and len(second.configuration.instances_of("setup")) == 1
        assert runs(programs) == ["first", "first"]
        entries = [each for each in saved(Workspace(tmp_path)).instances if each.instance.role == "setup"]
        assert [(each.instance.name, each.done) for each in entries] == [("setup", True)]
        await second.close()

    simulator.run(main())
