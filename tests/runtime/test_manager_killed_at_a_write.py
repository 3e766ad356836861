"""The manager killed at every durable write of a change in turn: the next one leaves a whole system, at one end."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
from collections.abc import Coroutine, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path
from typing import Any, Literal, NoReturn

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import MidstrideError, Unreachable
from midstride.model.component import Connector
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.overlap import overlap
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import planner
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.records.disk import ClosingConnection, Database, Disk, Statement
from midstride.runtime.records.state_store import SavedState, StateStore
from midstride.runtime.workspace import Workspace
from tests.runtime.side_by_side import all_replaced, three
from tests.runtime.systems import EXAMPLES, example

When = Literal["before", "after"]


class Killed(BaseException):
    """The manager has been killed."""


@dataclass
class MortalDisk(Disk):
    """Databases in memory. The manager is killed at write number ``dies_at``; nothing is written from then on."""

    dies_at: int = 0
    when: When = "before"
    writes: int = 0
    dies_at_request: int = 0  # or at that request to a component
    requests: int = 0
    dead: bool = False
    files: dict[Path, Database] = field(default_factory=dict)

    def open(self, path: Path, schema: str) -> Database:
        if path not in self.files:
            connection = sqlite3.connect(":memory:", check_same_thread=False, factory=ClosingConnection)
            connection.executescript(schema)
            self.files[path] = MortalDatabase(connection, self)
        return self.files[path]

    def read_only(self, path: Path) -> Database | None:
        return self.files.get(path)

    def saved(self, workspace: Workspace) -> SavedState:
        """What the next manager finds."""
        state = StateStore(workspace.state, disk=self).load()
        assert state is not None
        return state

    def revive(self) -> None:
        """The next manager has the same disk."""
        self.dies_at, self.dies_at_request, self.dead = 0, 0, False

    def on_request(self) -> None:
        """Raises Killed."""
        self.requests += 1
        self.dead = self.dead or self.requests == self.dies_at_request
        if self.dead:
            raise Killed


class MortalDatabase(Database):
    def __init__(self, connection: sqlite3.Connection, disk: MortalDisk) -> None:
        super().__init__(connection)
        self.disk = disk

    def write(self, statements: Iterable[Statement], only_if: Statement | None = None) -> None:
        disk = self.disk
        if disk.dead:
            raise Killed
        disk.writes += 1
        if disk.writes != disk.dies_at:
            super().write(statements, only_if)
            return
        if disk.when == "after":
            super().write(statements, only_if)
        disk.dead = True
        raise Killed

    def close(self) -> None:
        """The next manager finds it."""


def kill(manager: Manager) -> None:
    """From now on the manager does nothing, although its coroutines have not ended."""

    async def dead(*_: object, **__: object) -> NoReturn:
        raise Unreachable("the manager has been killed")

    launcher = manager._launcher
    manager._client._send = launcher.end = launcher.kill = launcher.abandon = dead  # type: ignore[method-assign]
    manager._launcher.start = dead  # type: ignore[method-assign]


async def until_killed(manager: Manager, work: Coroutine[Any, Any, object], disk: MortalDisk) -> None:
    """Do ``work`` until the disk kills the manager, or to the end."""
    send = manager._client._send

    async def mortal(*arguments: Any) -> Any:
        if disk.when == "before":
            disk.on_request()
            return await send(*arguments)
        reply = await send(*arguments)
        disk.on_request()
        return reply

    manager._client._send = mortal  # type: ignore[method-assign, assignment]
    doing = asyncio.ensure_future(work)
    while not (disk.dead or doing.done()):
        await asyncio.sleep(0.001)
    if disk.dead:
        kill(manager)
        doing.cancel()
    with suppress(MidstrideError, Killed, asyncio.CancelledError):
        await doing


START = example("talker")
REPLACED = START.with_node(changed(START.nodes["talker"], component="NewTalker"))


def moved() -> Specification:
    """The talker has been replaced, and there is another listener, on a topic that was not there before."""
    chatter = START.connectors["/chatter"]
    connectors = START.connectors.set("/news", Connector("/news", chatter.guarantee))
    listener, talker = START.nodes["listener"], START.nodes["talker"]
    (out,), (inlet,) = talker.attachments, listener.attachments
    return (
        changed(REPLACED, connectors=connectors)
        .with_node(Node("newscaster", "Talker", changed_attachments(talker, out)))
        .with_node(Node("reader", "Listener", changed_attachments(listener, inlet)))
    )


def changed_attachments(node: Node, port: str) -> Any:
    return node.attachments.set(port, type(node.attachments[port])(("/news",)))


def both_exchanged() -> Specification:
    """The talker has been replaced, and another listener has taken the first one's place."""
    exchanged = REPLACED.without_node("listener").with_node(changed(START.nodes["listener"], role="reader"))
    plan = planner("minimal")(change_between(initial(START), START, exchanged))
    assert len(overlap(plan).rounds[-1]) == 2, "the old ones are removed at once"
    return exchanged


CHANGES = {
    "replace": REPLACED,
    "more": moved(),
    "less": START.without_node("listener"),
    "both exchanged": both_exchanged(),
}


async def assert_whole(manager: Manager, simulator: Simulator, disk: MortalDisk, specification: Specification) -> None:
    """Exactly the nodes of ``specification`` run, in their best modes, and the journal has no open end."""
    assert manager.specification == disk.saved(manager._workspace).specification == specification
    status = await manager.status()
    assert status.valid and status.crashed == [] and status.unwritten is None and status.damaged is None
    assert sorted(simulator.processes) == sorted(manager.configuration.instances), "an orphan"
    wanted = initial(specification)
    assert list(manager.configuration.instances_by_role) == list(wanted.instances_by_role)
    assert set(manager.configuration.context.connectors) == set(specification.connectors)
    attached = {
        (found.instances[port.instance].role, port.port, found.topic(connector))
        for found in [manager.configuration]
        for name in found.instances
        for port, connector in found.attached_ports(name)
    }
    assert attached == {
        (role, port, topic)
        for role, node in specification.nodes.items()
        for port, topics in node.attachments.items()
        for topic in topics
    }
    endpoints = await simulator.endpoints()
    assert len(endpoints.publishers) + len(endpoints.subscribers) == len(attached), "an endpoint that nothing has"
    assert all(change.outcome is not None for change in (await manager.history(99)).changes)


@dataclass(frozen=True)
class Case:
    """A change from ``start`` to ``target``, with the programs in that folder."""

    target: Specification
    start: Specification = START
    programs: Path = EXAMPLES / "talker"


def killed_at_each_write(case: Case, folder: Path, *, finish: bool) -> set[str]:
    """Kill the manager at each write of the change; returns how the changes ended, by the journal."""
    outcomes: set[str] = set()
    number = 0
    while True:
        number += 1
        for when in ("before", "after"):
            disk = MortalDisk(when=when)
            outcome = killed_once(case, folder / f"{number}{when}", disk, finish=finish, at_write=number)
            if outcome is None:
                assert number > 10, "a change has more writes than that"
                return outcomes
            outcomes.add(outcome)


def killed_once(
    case: Case, folder: Path, disk: MortalDisk, *, finish: bool, at_write: int = 0, at_request: int = 0
) -> str | None:
    """How the change ended, by the journal; None if it has fewer writes, or requests, than that."""
    simulator, workspace = Simulator(), Workspace(folder)
    workspace.path.mkdir()

    async def main() -> str | None:
        first = Manager(case.start, simulator, workspace, case.programs, disk=disk)
        await first.up()
        disk.dies_at, disk.dies_at_request = at_write and disk.writes + at_write, at_request
        await until_killed(first, first.change(PlanRequest(to=case.target)), disk)
        with suppress(Killed):
            await first.close()
        if not disk.dead:
            return None
        await asyncio.sleep(1)
        options = SystemOptions(finish_interrupted=finish)
        disk.revive()
        specification = disk.saved(workspace).specification
        second = Manager(specification, simulator, workspace, case.programs, options=options, disk=disk)
        await second.up()
        try:
            end = second.specification
            assert end in (case.start, case.target)
            await asyncio.sleep(1)
            await assert_whole(second, simulator, disk, end)
            change = (await second.history(99)).changes[1:2]
            if not change:  # it was killed before it had begun
                assert end == case.start
                return "not begun"
            assert change[0].outcome == ("done" if end == case.target else "rolled_back"), "journal and world disagree"
            if finish:
                assert end == case.target
            return str(change[0].outcome)
        finally:
            await second.close()

    return simulator.run(main())


@pytest.mark.parametrize(
    "name",
    [
        "replace",
        "less",
        pytest.param("more", marks=pytest.mark.full),
        pytest.param("both exchanged", marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize(
    "finish",
    [pytest.param(False, id="rolled back"), pytest.param(True, id="finished", marks=pytest.mark.full)],
)
def test_the_next_manager_leaves_a_whole_system(name: str, finish: bool, tmp_path: Path) -> None:
    outcomes = killed_at_each_write(Case(CHANGES[name]), tmp_path, finish=finish)
    assert outcomes == ({"not begun", "done"} if finish else {"not begun", "done", "rolled_back"})


def side_by_side(folder: Path) -> Case:
    """Three publishers are handed over in one round."""
    start = three(folder, probation=0.2, watch_after=0.2)
    target = all_replaced().target(start)
    plan = planner("minimal")(change_between(initial(start), start, target))
    kinds = [{plan.steps[index].action.kind for index in some} for some in overlap(plan).rounds if len(some) == 3]
    assert kinds == [{"upgrade"}, {"handover"}, {"remove"}]
    return Case(target, start, folder)


@pytest.mark.full
@pytest.mark.parametrize(
    "finish", [pytest.param(False, id="rolled back"), pytest.param(True, id="finished", marks=pytest.mark.long)]
)
def test_the_same_where_steps_are_taken_at_once(finish: bool, tmp_path: Path) -> None:
    outcomes = killed_at_each_write(side_by_side(tmp_path), tmp_path, finish=finish)
    assert outcomes == ({"not begun", "done"} if finish else {"not begun", "done", "rolled_back"})


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize(
    "every", [17, pytest.param(5, marks=pytest.mark.long), pytest.param(1, marks=pytest.mark.long)]
)
def test_the_same_at_every_request_of_such_a_change(every: int, when: When, tmp_path: Path) -> None:
    """Before it is sent, and after its reply has come: between the cuts, and between the sides of each."""
    case, outcomes, number = side_by_side(tmp_path), list[str](), 1
    while True:
        folder, disk = tmp_path / str(number), MortalDisk(when=when)
        outcome = killed_once(case, folder, disk, finish=False, at_request=number)
        if outcome is None:
            break
        outcomes.append(outcome)
        number += every
    assert number > 80 and outcomes.count("rolled_back") > 3, (number, outcomes)


def test_a_manager_that_is_killed_while_it_brings_the_system_up_leaves_nothing_in_the_way(tmp_path: Path) -> None:
    simulator = Simulator()
    reached = set()

    async def main() -> None:
        for number in range(1, 100):
            workspace, disk = Workspace(tmp_path / str(number)), MortalDisk(dies_at=number)
            workspace.path.mkdir()
            first = Manager(START, simulator, workspace, EXAMPLES / "talker", disk=disk)
            await until_killed(first, first.up(), disk)
            with suppress(Killed):
                await first.close()
            if not disk.dead:
                return
            reached.add(len(simulator.processes))
            disk.revive()
            second = Manager(START, simulator, workspace, EXAMPLES / "talker", disk=disk)
            await second.up()
            await asyncio.sleep(1)
            await assert_whole(second, simulator, disk, START)
            await second.down()
            await second.close()

    simulator.run(main())
    assert reached == {0, 1, 2}


def test_a_change_that_the_next_manager_cannot_finish_is_rolled_back_and_that_is_said(tmp_path: Path) -> None:
    """The program of the new component cannot be started any more."""
    programs = tmp_path / "programs"
    shutil.copytree(EXAMPLES / "talker", programs)
    simulator, workspace, disk = Simulator(), Workspace(tmp_path / "system"), MortalDisk(when="after")
    workspace.path.mkdir()

    async def main() -> None:
        first = Manager(START, simulator, workspace, programs, disk=disk)
        await first.up()
        disk.dies_at = disk.writes + 5  # in the midst of it
        await until_killed(first, first.change(PlanRequest(to=REPLACED)), disk)
        with suppress(Killed):
            await first.close()
        assert disk.dead
        await asyncio.sleep(1)
        disk.revive()
        (programs / "new_talker.py").write_text("raise SystemExit('no camera')\n")
        options = SystemOptions(finish_interrupted=True)
        second = Manager(
            disk.saved(workspace).specification, simulator, workspace, programs, options=options, disk=disk
        )
        await second.up()
        try:
            await asyncio.sleep(1)
            await assert_whole(second, simulator, disk, START)
            notes = [event.words for event in second.log() if "cannot be finished" in event.words]
            assert len(notes) == 1 and "was interrupted, and cannot be finished: " in notes[0]
            assert (await second.history(99)).changes[1].outcome == "rolled_back"
        finally:
            await second.close()

    simulator.run(main())
