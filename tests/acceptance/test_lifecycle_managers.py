"""A lifecycle manager with bonds, as Nav2's, beside Midstride: what it would notice is refused, all else is done.

The manager and its nodes are those of examples/navigation, plain rclpy.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from midstride.backends import ros2
from midstride.errors import PlanRefused
from midstride.lang.load import load
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from tests.acceptance.foreign_support import manager_of
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

EXAMPLE = Path(__file__).parents[2] / "examples" / "navigation"
MANAGED = """system robot
parameters "nav2_params.yaml"
component Planner {{ run "python3 planner_server" gate preload }}
component Controller {{ run "python3 controller_server" gate preload }}
component Manager {{
  run "python3 lifecycle_manager" gate none
  parameters {{
    autostart = true
    node_names = ["controller_server", "planner_server"]
    bond_timeout = {bond_timeout}
  }}
}}
node controller_server : Controller
node planner_server : Planner
node lifecycle_manager_navigation : Manager
"""
RESTART = PlanRequest(restart=("planner_server",))


@asynccontextmanager
async def robot(folder: Path, bond_timeout: float) -> AsyncIterator[tuple[Manager, Bare]]:
    """The system under its lifecycle manager, once that has activated all."""
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    (folder / "nav2_params.yaml").write_text("controller_server:\n  ros__parameters: { controller_frequency: 20.0 }\n")
    (folder / "robot.stride").write_text(MANAGED.format(bond_timeout=bond_timeout), encoding="utf-8")
    (folder / "system").mkdir()
    manager = manager_of(load(folder / "robot.stride").require(), folder)
    with Bare("recorder") as bare:
        try:
            await manager.up()
            await bare.until(lambda: "Managed nodes are active" in log_of(folder), 60)
            yield manager, bare
        finally:
            await manager.down()
            await manager.close()


def log_of(folder: Path) -> str:
    """What the lifecycle manager has written."""
    return "".join(path.read_text(encoding="utf-8") for path in folder.rglob("*lifecycle_manager_navigation*.log"))


async def active(bare: Bare, *names: str) -> None:
    """Wait until these nodes say that they are active."""
    from lifecycle_msgs.srv import GetState

    for name in names:
        client = bare.node.create_client(GetState, f"/{name}/get_state")
        await bare.until(client.service_is_ready, 30)
        asked = client.call_async(GetState.Request())
        await bare.until(asked.done, 30)
        bare.node.destroy_client(client)
        assert asked.result().current_state.label == "active", name


def test_what_would_break_a_bond_is_refused_and_without_the_manager_the_nodes_are_replaced(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(tmp_path, 4.0) as (manager, bare):
            # Right after the start: the plan waits until it is known which manager has the node.
            with pytest.raises(PlanRefused, match="has a bond of 4 s with /planner_server") as refused:
                await manager.plan(RESTART)
            outcome = await manager.change(RESTART)
            assert (outcome.outcome, outcome.because) == ("refused", str(refused.value))
            assert (await manager.change(PlanRequest(remove=("controller_server",)))).outcome == "refused"
            graph = await asyncio.to_thread(ros2.observe, 1.0)
            assert graph.lifecycle == {"/controller_server", "/planner_server"}
            assert graph.managers == {"/lifecycle_manager_navigation": {"/controller_server", "/planner_server"}}
            assert not any(topic == "/bond" for _, topic, _ in graph.endpoints)
            await active(bare, "controller_server", "planner_server")
            assert "CRITICAL FAILURE" not in log_of(tmp_path)

            # Without the manager, a node is replaced at once, by one that is taken to its state.
            removed = await manager.change(PlanRequest(remove=("lifecycle_manager_navigation",)))
            assert removed.outcome == "done"
            outcome = await manager.change(RESTART)
            assert (outcome.outcome, outcome.because) == ("done", None)
            await active(bare, "controller_server", "planner_server")

    with ended():
        run(scenario())


def test_a_manager_without_bonds_does_not_notice_and_a_broken_bond_would_have_taken_all_down(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(tmp_path, 0.0) as (manager, bare):
            await bare.until(
                lambda: bool(manager.system.life.latest_states["planner_server"].state.lifecycle_callers), 30
            )
            plan = PlanPreview.of(await manager.plan(RESTART)).continuity
            assert plan and "lifecycle services" not in plan.headline  # the new node has the name, and answers
            # What asks for the state meanwhile sees one node that never leaves `active`.
            change = asyncio.ensure_future(manager.change(RESTART))
            asked = 0
            while not change.done():
                await active(bare, "planner_server")
                asked += 1
            assert (change.result().outcome, change.result().because) == ("done", None)
            assert asked > 1
            await active(bare, "controller_server", "planner_server")
            await bare.until_named("planner_server")
            assert "Failed to change state" not in log_of(tmp_path)

    with ended():
        run(scenario())


@pytest.mark.long  # the bonds themselves are formed in each test above
def test_the_stand_in_takes_all_down_when_a_bond_breaks_and_the_status_says_so(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(tmp_path, 2.0) as (manager, bare):
            await bare.until(lambda: bool(manager.system.life.latest_states["planner_server"].state.managed), 30)
            (planner,) = (each for each in (await manager.status()).instances if each.name == "planner_server")
            assert planner.pid is not None
            os.kill(planner.pid, signal.SIGKILL)
            await bare.until(lambda: "SERVER planner_server IS DOWN" in log_of(tmp_path), 30)

            def faults() -> list[str]:
                return [*manager.system.life.latest_states["controller_server"].state.differences]

            await bare.until(lambda: any("was active before" in each for each in faults()), 60)
            assert (await manager.status()).condition.state == "degraded"

    with ended():
        run(scenario())
