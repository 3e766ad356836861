"""ROS actions of nodes without Midstride's API across replacements: every goal ends with its result, as clients count.

MIDSTRIDE_REPLACEMENTS says how many replacements the long test makes, where 100 take too long.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import pytest

from midstride import backends
from midstride.foreign.page import GATES_FOLDER
from midstride.foreign.record import ForeignRecord
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.restore.half_done import HALF_DONE
from midstride.runtime.workspace import Workspace
from midstride.verdicts.assessment import Assessments
from tests.acceptance.acting import CANCELED, SERVER, SUCCEEDED, Goals, asked, written, written_with_api
from tests.acceptance.foreign_support import Robot, declared_talker, robot
from tests.acceptance.support import ROOT, ended
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_REPLACEMENTS", "100"))


async def accepted(system: Robot, client: Any, order: int) -> Any:
    from test_msgs.action import Fibonacci

    asked = client.send_goal_async(Fibonacci.Goal(order=order))
    await system.until(asked.done)
    assert asked.result().accepted
    return asked.result()


async def fetched_late(system: Robot, client: Any) -> None:
    """The result of a goal that no client fetches as long as its server runs is the successor's to answer."""
    goal = await accepted(system, client, 2)
    outcome = await system.change("Brief")
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert "goal" not in str(outcome.continuity), outcome.continuity
    result = goal.get_result_async()
    await system.until(result.done)
    assert (result.result().status, list(result.result().result.sequence)) == (SUCCEEDED, [0, 1])


async def cut_short(system: Robot, client: Any) -> None:
    """A goal that does not end in time is cancelled, and its client gets what it has come to; the report says so."""
    result = (await accepted(system, client, 100_000)).get_result_async()
    outcome = await system.change("Plain")
    await system.until(result.done)
    assert result.result().status == CANCELED and result.result().result.sequence
    assert outcome.outcome == "done" and isinstance(outcome.continuity, Assessments)
    (words,) = (each.words for each in outcome.continuity.found if "goal" in each.words)
    assert "1 goal of ROS action /count had not ended after 1 s (`patience`), and cancelling was asked for" in words


async def planned_for_a_while(system: Robot, component: str) -> None:
    """The plan says where goals in progress go on, and for how long at most."""
    planned = await system.manager.plan(PlanRequest(replace=(("talker", component),)))
    (goals,) = (each.words for each in planned.besides if each.words.startswith("goals of others"))
    assert "ROS action /count: they continue at talker" in goals
    assert "for at most 60 s (`patience`)" in goals
    (between,) = (step.between for step in planned.steps if step.action.kind == "remove")
    assert between is not None and between[1] >= 60.0


def replaced_often(
    folder: Path, components: Sequence[str], order: int = 15, write: Callable[[Path], Path] = written
) -> None:
    """Replace the server by each of ``components`` under goals in progress."""
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")

    async def scenario() -> None:
        from rclpy.action import ActionClient
        from test_msgs.action import Fibonacci

        async with robot(load(write(folder)).require(), folder) as system:
            async with asked(folder, system, order) as found:
                for component in components:
                    if write is written:
                        await planned_for_a_while(system, component)
                    outcome = await system.change(component)
                    assert (outcome.outcome, outcome.because) == ("done", None)
                    assert "goal" not in str(outcome.continuity), outcome.continuity
                    counted = outcome.goals["talker"]
                    assert counted.accepted and not (counted.lost or counted.unknown), counted.words
                    ends = counted.ended_at_old + counted.ended_at_new + counted.cancelled
                    assert counted.accepted == ends + counted.in_progress, counted.words
            system.require_changes(len(components))
            assert system.holes() == []
            if write is written:
                client: Any = ActionClient(system.bare.node, Fibonacci, "/count")
                await system.until(client.server_is_ready)
                await fetched_late(system, client)
                await cut_short(system, client)
                client.destroy()
            ways = Counter(each.status for each in found.ended)
            print(f"{len(found.ended)} goals, {ways[SUCCEEDED]} succeeded, {ways[CANCELED]} were cancelled")
            assert ways[SUCCEEDED] and ways[CANCELED]

    with ended():
        run(scenario(), 3600)


def test_every_goal_is_executed_once_across_replacements(tmp_path: Path) -> None:
    """From rclpy to C, and back."""
    replaced_often(tmp_path, ["Native", "Plain"])


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("kinds", "write"),
    [
        pytest.param(("Other", "Plain"), written, id="rclpy"),
        pytest.param(("Native", "Compiled"), written, id="C"),
        pytest.param(("OwnOther", "Own"), written_with_api, id="API"),
    ],
)
def test_every_goal_is_executed_once_across_many_replacements(
    tmp_path: Path, kinds: tuple[str, str], write: Callable[[Path], Path]
) -> None:
    replaced_often(tmp_path, list(islice(cycle(kinds), REPLACEMENTS)), order=40, write=write)


def test_the_next_manager_ends_a_node_whose_goals_go_on(tmp_path: Path) -> None:
    """A manager is killed while the old node goes on: all goals end, and then that node does."""
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    folder = tmp_path / "system"

    def manager() -> Manager:
        options = SystemOptions(finish_interrupted=True)
        workspace = Workspace(folder)
        return Manager(specification, backends.make("ros2", workspace), workspace, tmp_path, options=options)

    def drains() -> bool:
        record = ForeignRecord.read(Workspace(folder).components / GATES_FOLDER, "source")
        return record is not None and record.draining_since is not None

    async def scenario() -> None:
        from rclpy.action import ActionClient
        from test_msgs.action import Fibonacci

        folder.mkdir()
        async with replaced_later(manager()) as system:
            client: Any = ActionClient(system.bare.node, Fibonacci, "/count")
            await system.until(client.server_is_ready)
            cancelled, endless = [await accepted(system, client, 100_000) for _ in range(2)]
            results = [goal.get_result_async() for goal in (cancelled, endless)]
            command = [sys.executable, "-m", "tests.acceptance.managing", str(folder), "swap"]
            with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as killed:
                await system.until(drains)
                killed.kill()
            # Without a manager, new goals go to the new one, and what is asked about the others reaches the old one.
            new = await accepted(system, client, 5)
            results.append(new.get_result_async())
            cancelled.cancel_goal_async()
            await system.until(lambda: results[0].done() and results[2].done())
            assert not results[1].done()
            system.manager = manager()
            await system.meanwhile(system.manager.up())
            await system.until(lambda: all(each.done() for each in results))
            found = [(each.result().status, len(each.result().result.sequence)) for each in results]
            assert [status for status, _ in found] == [CANCELED, CANCELED, SUCCEEDED] and found[2][1] == 5
            executed = Counter(Goals(tmp_path).executed)
            assert executed == Counter(bytes(goal.goal_id.uuid).hex() for goal in (cancelled, endless, new))
            assert list(system.manager.configuration.instances) == ["source_2"]
            (words,) = (each.words for each in system.manager.events.since(0) if each.kind == HALF_DONE)
            assert "source, which an earlier manager had left half done" in words
            assert "1 goal of ROS action /count had not ended after" in words
            assert "ended with source" not in words, "the services go on at source_2"
            notes = [each.words for each in system.manager.events.since(0) if "ROS actions in progress" in each.words]
            assert notes == [
                "source, which an earlier manager had left half done, has 1 goal of ROS actions in progress: "
                "it is ended when they have ended, after 14 s at the latest"
            ]
            client.destroy()

    specification = load(written_for_a_manager_that_dies(tmp_path)).require()
    with ended():
        run(scenario())


def written_for_a_manager_that_dies(folder: Path) -> Path:
    """The system of :mod:`tests.acceptance.managing`: a node `source`, and two components that run the server."""
    (folder / "server.py").write_text(SERVER)
    text = "system serving\ntopic /swap : std_msgs/msg/String @ 50 Hz\n"
    for name in ("Source", "OtherSource"):
        talker = declared_talker(name, f"{sys.executable} {folder / 'server.py'}", "preload")
        text += talker.replace(" gate", " stop patience 5 s gate")
    path = folder / "killed.stride"
    path.write_text(f"{text}node source : Source {{ out -> /swap }}\n", encoding="utf-8")
    return path


@asynccontextmanager
async def replaced_later(manager: Manager) -> AsyncIterator[Robot]:
    """The system of ``manager``, which is up without it; it is ended by the manager that the robot has then."""
    with Bare("asking") as bare:
        system = Robot(Path(), manager, bare)
        await system.meanwhile(manager.up())
        await manager.close()
        try:
            yield system
        finally:
            if system.manager is not manager:
                await system.meanwhile(system.manager.down())
                await system.manager.close()
