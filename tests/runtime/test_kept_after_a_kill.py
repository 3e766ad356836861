"""A manager killed at every request of a replacement: values and state outlast it, whichever instance stays."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.lang.load import load_text
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, last_said, replace, saved, stateful_talkers
from tests.runtime.test_manager_killed_at_a_write import Killed, MortalDisk, When, until_killed
from tests.runtime.test_one_answers import answering
from tests.runtime.test_parameters import set_by_a_tool, source, tuned, values

RESTART = PlanRequest(restart=("talker",))
REPLACE = replace("talker", "NewTalker")


def killed_at(
    specification: Specification,
    folder: Path,
    request: PlanRequest,
    disk: MortalDisk,
    number: int,
    before: Callable[[Simulator], Awaitable[object]],
    meanwhile: Callable[[Simulator], Awaitable[object]],
    after: Callable[[Manager, Simulator], Awaitable[object]],
    finish: bool = False,
) -> bool:
    """Kill the manager at a request of a change; False where the change has fewer of them.

    ``before`` is awaited before the change, ``meanwhile`` while no manager runs, and ``after`` with the next one.
    """
    simulator, workspace = Simulator(), Workspace(folder)
    workspace.path.mkdir()

    async def main() -> bool:
        first = Manager(specification, simulator, workspace, EXAMPLES / "talker", disk=disk)
        await first.up()
        await before(simulator)
        disk.dies_at_request = number
        await until_killed(first, first.change(request), disk)
        with suppress(Killed):
            await first.close()
        if not disk.dead:
            return False
        await asyncio.sleep(1)
        await meanwhile(simulator)
        disk.revive()
        options = SystemOptions(finish_interrupted=finish)
        second = Manager(
            disk.saved(workspace).specification, simulator, workspace, EXAMPLES / "talker", options=options, disk=disk
        )
        await second.up()
        try:
            await asyncio.sleep(1)
            assert (await second.status()).valid
            assert sorted(simulator.processes) == sorted(second.configuration.instances), "an orphan"
            await after(second, simulator)
            assert (left := disk.saved(workspace)).carried == {} and left.exported == {}
        finally:
            await second.close()
        return True

    return simulator.run(main())


def at_each_request(work: Callable[[Path, MortalDisk, int], bool], folder: Path, when: When, every: int) -> int:
    """Do ``work`` for one request after the other; how many there were."""
    number = 1
    while True:
        inner = folder / f"{number}{when}"
        if not work(inner, MortalDisk(when=when), number):
            return number
        number += every


EVERY = pytest.mark.parametrize(
    "every", [pytest.param(7, marks=pytest.mark.full), pytest.param(1, marks=pytest.mark.long)]
)
FEW = pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.full)])
WHEN = pytest.mark.parametrize("when", ["before", "after"])


@EVERY
@WHEN
@pytest.mark.parametrize("request_", [RESTART, REPLACE], ids=["restart", "replace"])
@pytest.mark.parametrize("finish", [False, True], ids=["rolled back", "finished"])
def test_what_is_set_between_two_managers_is_kept(
    finish: bool, request_: PlanRequest, when: When, every: int, tmp_path: Path
) -> None:
    """It is set on the instance that answers then, and the next manager may keep the other one."""
    specification, carried = tuned(tmp_path), list[str]()

    async def before(simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "label", "left")
        await set_by_a_tool(simulator, "talker", "gain", 1.7)

    async def meanwhile(simulator: Simulator) -> None:
        (one,) = answering(simulator, "talker") or sorted(each for each in simulator.processes if "talker" in each)[:1]
        await set_by_a_tool(simulator, one, "gain", 1.9)

    async def after(manager: Manager, _: Simulator) -> None:
        (talker,) = (name for name, each in manager.configuration.instances.items() if each.role == "talker")
        found, _declared = await values(manager, talker)
        assert found == {"gain": 1.9, "label": "left"}
        half_done = (event.words for event in manager.log() if event.kind == "half_done")
        carried.extend(words for words in half_done if "gain = 1.9" in words)

    def work(folder: Path, disk: MortalDisk, number: int) -> bool:
        return killed_at(specification, folder, request_, disk, number, before, meanwhile, after, finish)

    assert at_each_request(work, tmp_path, when, every) > 10
    assert all("lost: what was set" not in words for words in carried)


@FEW
@pytest.mark.parametrize("back", [False, True], ids=["another value", "the declared value"])
def test_the_later_of_two_values_counts(back: bool, every: int, tmp_path: Path) -> None:
    """Both have got one since values were last carried over; the one that goes on has taken over: its own is later."""

    specification, ended = tuned(tmp_path), list[str]()
    value = 1.5 if back else 2.2

    async def before(simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)

    async def meanwhile(simulator: Simulator) -> None:
        if {"talker", "talker_2"} <= simulator.processes.keys() and answering(simulator, "talker") == ["talker_2"]:
            await set_by_a_tool(simulator, "talker", "label", "only here")
            await set_by_a_tool(simulator, "talker", "gain", 1.9)
            await set_by_a_tool(simulator, "talker_2", "gain", value)
            ended.append("")

    async def after(manager: Manager, _: Simulator) -> None:
        (talker,) = (name for name, each in manager.configuration.instances.items() if each.role == "talker")
        if ended[-1:] == [""]:
            ended[-1] = next(event.words for event in manager.log() if event.kind == "half_done")
            found, _declared = await values(manager, talker)
            assert found == {"gain": value, "label": "only here"}

    def work(folder: Path, disk: MortalDisk, number: int) -> bool:
        return killed_at(specification, folder, RESTART, disk, number, before, meanwhile, after)

    at_each_request(work, tmp_path, "after", every)
    assert ended
    for words in ended:
        assert "talker: label = 'only here', set at run time: kept; " in words
        assert "; lost: what was set on talker while it ran: gain = 1.9" in words


@FEW
def test_what_the_one_that_stays_refuses_is_said(every: int, tmp_path: Path) -> None:
    specification, said = tuned(tmp_path, source(2.5, limit=10)), list[str]()

    async def before(simulator: Simulator) -> None:
        pass

    async def meanwhile(simulator: Simulator) -> None:
        if "talker" in simulator.processes:
            await set_by_a_tool(simulator, "talker", "gain", 50.0)

    async def after(manager: Manager, _: Simulator) -> None:
        half_done = (event.words for event in manager.log() if event.kind == "half_done")
        said.extend(words for words in half_done if "talker_2 goes on" in words)

    def work(folder: Path, disk: MortalDisk, number: int) -> bool:
        return killed_at(specification, folder, REPLACE, disk, number, before, meanwhile, after, finish=True)

    at_each_request(work, tmp_path, "after", every)
    assert said
    for words in said:
        assert "gain = 50.0, set at run time: too late, after the hand-over: " in words and "from 0 to 10" in words


@EVERY
@WHEN
@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
@pytest.mark.parametrize("finish", [False, True], ids=["rolled back", "finished"])
def test_state_outlasts_the_manager(finish: bool, strategy: Any, when: When, every: int, tmp_path: Path) -> None:
    """Under a strategy that removes first, the manager alone has it for a while."""
    specification, taken_up = stateful_talkers(tmp_path), set[str]()
    request = changed(REPLACE, strategy=strategy)

    async def before(simulator: Simulator) -> None:
        program: Any = simulator.processes["talker"]._program
        program._main.__dict__["state"] = "what it has learned"

    async def nothing(_: Simulator) -> None:
        pass

    async def after(_: Manager, simulator: Simulator) -> None:
        taken_up.add(await last_said(simulator))

    def work(folder: Path, disk: MortalDisk, number: int) -> bool:
        return killed_at(specification, folder, request, disk, number, before, nothing, after, finish)

    at_each_request(work, tmp_path, when, every)
    assert taken_up and all(said.startswith("what it has learned") for said in taken_up), taken_up


@pytest.mark.parametrize("later", [0, 3], ids=["while it goes on", "when it has ended"])
def test_a_process_imports_once_what_takes_longer_than_its_manager_lives(later: float, tmp_path: Path) -> None:
    """The next manager has the state, too, and cannot know that it was imported."""
    specification = stateful_talkers(tmp_path)
    for program in tmp_path.glob("*.py"):
        text = program.read_text().replace(
            'state = given.decode() + "+"',
            'imports.append(given)\n    time.sleep(1.5)\n    state = f"imported {len(imports)} times"',
        )
        program.write_text(f"import time\n\nimports = []\n{text}")
    simulator, workspace, disk = Simulator(), Workspace(tmp_path / "system"), MortalDisk()
    workspace.path.mkdir()

    def imports(name: str) -> list[bytes]:
        program: Any = simulator.processes[name]._program if name in simulator.processes else None
        found: list[bytes] = [] if program is None else getattr(program._main, "imports", [])
        return found

    async def dies_meanwhile() -> None:
        while not imports("talker_2"):
            await asyncio.sleep(0.01)
        disk.dead = True

    async def main() -> None:
        first = Manager(specification, simulator, workspace, EXAMPLES / "talker", disk=disk)
        await first.up()
        killing = asyncio.ensure_future(dies_meanwhile())
        await until_killed(first, first.change(changed(REPLACE, strategy="paper")), disk)
        await killing
        with suppress(Killed):
            await first.close()
        await asyncio.sleep(later)
        disk.revive()
        options = SystemOptions(finish_interrupted=True)
        second = Manager(specification, simulator, workspace, EXAMPLES / "talker", options=options, disk=disk)
        await second.up()
        await asyncio.sleep(5)
        assert not any("did not restore its state" in event.words for event in second.log())
        [note] = [event.words for event in second.log() if "has the state of" in event.words]
        assert note == "talker_2 has the state of talker, which was exported before the last manager ended"
        assert len(imports("talker_2")) == 1
        assert await last_said(simulator) == "imported 1 times"
        assert disk.saved(workspace).exported == {}
        await second.close()

    simulator.run(main())


@EVERY
@pytest.mark.parametrize("strategy", ["paper", "quiesce"])
def test_state_outlasts_the_manager_where_more_is_replaced(strategy: Any, every: int, tmp_path: Path) -> None:
    """The topic has been taken from one of two talkers, and the other one still is as it was."""
    text = (EXAMPLES / "talker" / "talker.stride").read_text()
    text = text.replace("topic /chatter : Text", "topic /chatter : Text\ntopic /other : Text")
    two = load_text(f"{text}\nnode second : Talker {{ out -> /other }}\n").require()
    specification, taken_up = changed(two, components=stateful_talkers(tmp_path).components), set[str]()
    request = PlanRequest(replace=(("talker", "NewTalker"), ("second", "NewTalker")), strategy=strategy)

    async def before(simulator: Simulator) -> None:
        for name in ("talker", "second"):
            program: Any = simulator.processes[name]._program
            program._main.__dict__["state"] = "what it has learned"

    async def nothing(_: Simulator) -> None:
        pass

    async def after(_: Manager, simulator: Simulator) -> None:
        taken_up.add(await last_said(simulator))
        taken_up.add(await last_said(simulator, "/other"))

    def work(folder: Path, disk: MortalDisk, number: int) -> bool:
        return killed_at(specification, folder, request, disk, number, before, nothing, after, finish=True)

    at_each_request(work, tmp_path, "after", every)
    assert taken_up and all(said.startswith("what it has learned") for said in taken_up), taken_up


async def killed_as_one_is_ended(manager: Manager, request: PlanRequest, disk: MortalDisk) -> None:
    """Bring the system up, and have the manager be killed when its change has ended a process."""
    await manager.up()
    end = manager._launcher.end

    async def ending(name: str, *, asked: bool = False, whole: bool = False) -> None:
        await end(name)
        disk.dead = True

    manager._launcher.end = ending  # type: ignore[method-assign]
    await until_killed(manager, manager.change(request), disk)
    with suppress(Killed):
        await manager.close()
    disk.revive()


def test_an_instance_that_has_taken_over_keeps_what_it_has_learned_since(tmp_path: Path) -> None:
    """The one before has exported its state as it was removed, and that one has continued with it for some time."""
    specification = stateful_talkers(tmp_path)
    simulator, workspace, disk = Simulator(), Workspace(tmp_path / "system"), MortalDisk(when="after")
    workspace.path.mkdir()

    async def main() -> None:
        first = Manager(specification, simulator, workspace, EXAMPLES / "talker", disk=disk)
        await killed_as_one_is_ended(first, RESTART, disk)
        program: Any = simulator.processes["talker_2"]._program
        program._main.__dict__["state"] = "what it has learned"
        second = Manager(specification, simulator, workspace, EXAMPLES / "talker", disk=disk)
        await second.up()
        assert await last_said(simulator) == "what it has learned"
        await second.close()

    simulator.run(main())


def test_state_that_waits_for_its_role_is_imported_by_a_later_start(tmp_path: Path) -> None:
    """The program cannot be started when the next manager comes up: what its predecessor has exported waits."""
    specification = stateful_talkers(tmp_path)
    simulator, workspace, disk = Simulator(), Workspace(tmp_path / "system"), MortalDisk(when="after")
    workspace.path.mkdir()

    async def main() -> None:
        first = Manager(specification, simulator, workspace, EXAMPLES / "talker", disk=disk)
        await killed_as_one_is_ended(first, changed(RESTART, strategy="paper"), disk)
        assert disk.saved(workspace).exported["talker"].state == b"the old one's"
        program = (tmp_path / "Talker.py").read_text()
        (tmp_path / "Talker.py").write_text("raise SystemExit('no camera')\n")
        second = Manager(specification, simulator, workspace, EXAMPLES / "talker", disk=disk)
        report = await second.up()
        assert [*report.missing] == ["talker"] and disk.saved(workspace).exported
        (tmp_path / "Talker.py").write_text(program)
        outcome = await second.change(RESTART)
        assert outcome.outcome == "done", outcome.because
        assert await last_said(simulator) == "the old one's+"
        assert disk.saved(workspace).exported == {}
        assert any("which was exported before the last manager ended" in event.words for event in second.log())
        await second.close()

    simulator.run(main())


def test_a_manager_that_is_not_killed_leaves_nothing(tmp_path: Path) -> None:
    simulator, workspace = Simulator(), Workspace(tmp_path / "system")
    workspace.path.mkdir()

    async def main() -> None:
        manager = Manager(tuned(tmp_path), simulator, workspace, EXAMPLES / "talker")
        await manager.up()
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        assert (await manager.change(REPLACE)).outcome == "done"
        assert saved(workspace).carried == {}
        await manager.close()

    simulator.run(main())
