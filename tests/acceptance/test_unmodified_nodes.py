"""Nodes in plain rclpy, those of docs/how-to/unmodified-nodes.md, are replaced while a bare recorder listens."""

from __future__ import annotations

import asyncio
import os
from itertools import pairwise
from pathlib import Path

import pytest

from midstride import backends
from midstride.lang.load import load
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.acceptance.foreign_support import programs_of_the_page
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run

SWAPS = int(os.environ.get("MIDSTRIDE_UNMODIFIED_SWAPS", "2"))
pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(120 + 10 * SWAPS)]


def specification(folder: Path) -> Specification:
    """That of the page, with its programs in ``folder``."""
    programs_of_the_page(folder)
    return load(folder / "chat.stride").require()


def test_nothing_is_missed_and_one_is_heard_at_each_moment(tmp_path: Path) -> None:
    (tmp_path / "system").mkdir()
    workspace = Workspace(tmp_path / "system")
    heard: list[tuple[str, int]] = []

    def manager_of(current: Specification) -> Manager:
        return Manager(current, backends.make("ros2", workspace), workspace, tmp_path)

    async def replaced(manager: Manager, bare: Bare, component: str) -> None:
        change = asyncio.ensure_future(manager.change(PlanRequest(replace=(("talker", component),))))
        await bare.until(change.done, 60)
        assert (change.result().outcome, change.result().because) == ("done", None)
        count = len(heard)
        await bare.until(lambda: len(heard) > count + 20)

    async def scenario() -> None:
        from std_msgs.msg import String

        manager = manager_of(specification(tmp_path))
        await manager.up()
        with Bare("recorder") as bare:

            def hear(message: String) -> None:
                name, number = message.data.split()
                heard.append((name, int(number)))

            bare.node.create_subscription(String, "/chat", hear, 1000)
            await bare.until(lambda: len(heard) > 50)
            for number in range(SWAPS):
                await replaced(manager, bare, ("NewTalker", "Talker")[number % 2])
                if number == (SWAPS - 1) // 2:  # the nodes go on without a manager, and the next one goes on with them
                    await manager.close()
                    count = len(heard)
                    await bare.until(lambda count=count: len(heard) > count + 20)  # type: ignore[misc]
                    manager = manager_of(manager.specification)
                    await manager.up()
            status = await manager.status()
            assert status.valid, status
        await manager.down()
        await manager.close()

    with ended():
        run(scenario(), 90 + 10 * SWAPS)
    changes = [(old, new) for (old, _), (new, _) in pairwise(heard) if old != new]
    assert len(changes) == SWAPS
    # One that has the topic writes all of its messages, and after the change none.
    assert all(number == last + 1 for (before, last), (writer, number) in pairwise(heard) if before == writer)
