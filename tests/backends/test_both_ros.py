"""One manager with components on ROS 1, another on ROS 2, at the same time: neither disturbs the other."""

from __future__ import annotations

import asyncio
import uuid
from functools import partial
from pathlib import Path

import pytest

from midstride.backends import ros1
from midstride.cli.input_files import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.process.reaper import Reaper, remaining_groups
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.backends.ros1_support import own_master_uri
from tests.backends.ros2_support import messages_are_numbered, run, until_async

EXAMPLE = Path(__file__).parents[2] / "examples" / "talker"
OURS = "MIDSTRIDE_TEST_RUN"

pytestmark = [
    pytest.mark.ros2,
    pytest.mark.full,
    pytest.mark.skipif(not ros1.available(), reason="no ROS 1 can be had here beside ROS 2"),
]


async def only_talker_3_publishes(manager: Manager) -> bool:
    seen = await manager._backend.endpoints()
    return {node for node, topic in seen.publishers if topic == "/chatter"} == {"/talker_3"}


def loaded(pid: int) -> str:
    """The libraries that a process has mapped, and its environment."""
    process = Path(f"/proc/{pid}")
    return (process / "maps").read_text() + (process / "environ").read_text(errors="replace").replace("\0", "\n")


def test_each_replaces_its_talker_while_the_other_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from midstride import backends

    this = uuid.uuid4().hex
    monkeypatch.setenv(OURS, this)

    async def bring_up(name: str, guardian: Reaper) -> Manager:
        folder = tmp_path / name
        folder.mkdir()
        workspace = Workspace(folder)
        platform = backends.make(name, workspace, guardian=guardian)
        manager = Manager(load(EXAMPLE / "talker.stride"), platform, workspace, EXAMPLE)
        await manager.up()
        return manager

    async def replace(manager: Manager) -> list[Outcome]:
        """There and back again."""
        outcomes = []
        for component in ("NewTalker", "Talker"):
            outcomes.append(await manager.change(PlanRequest(replace=(("talker", component),))))
        return outcomes

    async def scenario(guardian: Reaper) -> None:
        managers = [await bring_up("ros1", guardian), await bring_up("ros2", guardian)]
        try:
            states = [await manager.status() for manager in managers]
            assert [state.valid for state in states] == [True, True]
            pids = [{row.pid or 0 for row in state.instances} for state in states]
            assert not pids[0] & pids[1] and all(len(found) == 2 for found in pids)
            for pid in pids[0]:
                assert "rclpy" not in loaded(pid) and "AMENT_PREFIX_PATH" not in loaded(pid)
            for pid in pids[1]:
                assert "rclpy" in loaded(pid) and "rospy" not in loaded(pid)
            for outcomes in await asyncio.gather(*(replace(manager) for manager in managers)):
                for outcome in outcomes:
                    assert outcome.outcome == "done", outcome.because
                    assert outcome.below_baseline_seconds == {}
                    (swap,) = outcome.swaps
                    assert swap.subscriber == "listener.in"
                    assert swap.lost == 0 or (swap.lost is None and not messages_are_numbered())
                    assert swap.duplicates in (0, None)  # not every ROS 2 tells the publisher's identity
            for manager in managers:
                # A node's name may reach the graph seconds after its endpoints.
                await until_async(partial(only_talker_3_publishes, manager), 10.0)
        finally:
            for manager in managers:
                await manager.down()
                await manager.close()

    with own_master_uri(), Reaper(OURS, this) as guardian:
        run(scenario(guardian), 140)
        assert remaining_groups({}, OURS, this) - {guardian.pid} == set()
