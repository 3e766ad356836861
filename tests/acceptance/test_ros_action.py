"""A ROS action of a component, on the node that `on_setup` gets, across a replacement: real rclpy throughout."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.model.component import DEFAULT_STOP, NodeEndpoint
from midstride.verdicts.assessment import Assessments
from tests.acceptance.support import ended, managed, other_source
from tests.acceptance.test_node_name import specification
from tests.backends.ros2_support import Bare, run

pytestmark = pytest.mark.ros2

# Its action ``~/count`` counts to the number that a goal asks for, at 20 Hz. `on_stop` has goals in progress aborted.
# The last number of a result is 1000 for an instance without a suffix, 1002 for source_2.
_SERVER = """
from midstride import Component
from rclpy.action import ActionServer, CancelResponse
from std_msgs.msg import String
from test_msgs.action import Fibonacci

comp = Component("source")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])
work.set_normal_mode(lambda: out.write(String(data="x")), rate=50, outputs=[out])
work.set_degraded_mode(lambda: None)
stopping = False
in_progress = []

async def count(goal):
    in_progress.append(goal)
    result = Fibonacci.Result()
    while len(result.sequence) < goal.request.order and not (stopping or goal.is_cancel_requested):
        result.sequence.append(len(result.sequence))
        await comp.clock.sleep(0.05)
    if stopping:
        goal.abort()
    elif goal.is_cancel_requested:
        goal.canceled()
    else:
        goal.succeed()
    result.sequence.append(1000 + int(comp.instance.partition("_")[2] or 0))
    in_progress.remove(goal)
    return result

@comp.on_setup
def set_up(node):
    ActionServer(node, Fibonacci, "~/count", count, cancel_callback=lambda goal: CancelResponse.ACCEPT)

@comp.on_stop
async def stop():
    global stopping
    stopping = True
    while in_progress:
        await comp.clock.sleep(0.01)
    await comp.clock.sleep(0.2)  # rclpy sends the result afterwards

comp.start()
"""


@pytest.mark.full
def test_a_ros_action_is_answered_by_one_instance_and_goals_in_progress_are_ended(tmp_path: Path) -> None:
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    from action_msgs.msg import GoalStatus
    from rclpy.action import ActionClient
    from test_msgs.action import Fibonacci

    (tmp_path / "action.py").write_text(_SERVER)
    system = specification(tmp_path)
    components = {
        name: replace(
            component,
            run=f"{sys.executable} {tmp_path / 'action.py'}",
            allows=(NodeEndpoint("action", "~/count"),),
            stop=replace(DEFAULT_STOP, patience=1.0),
        )
        for name, component in system.components.items()
    }
    system = replace(system, components=Map(components))

    async def main() -> None:
        async with managed(tmp_path / "system", system, tmp_path) as (manager, _):
            with Bare() as bare:
                client = ActionClient(bare.node, Fibonacci, "/source/count")

                async def finished(future: Any) -> Any:
                    await bare.until(future.done)
                    return future.result()

                async def accepted(order: int) -> Any:
                    goal = await finished(client.send_goal_async(Fibonacci.Goal(order=order)))
                    assert goal.accepted
                    return goal

                await bare.until(client.server_is_ready)
                done = await finished((await accepted(2)).get_result_async())
                assert (done.status, list(done.result.sequence)) == (GoalStatus.STATUS_SUCCEEDED, [0, 1, 1000])

                long = await accepted(100_000)
                result = long.get_result_async()
                replacing = asyncio.ensure_future(manager.change(other_source(manager)))
                while not replacing.done():
                    await bare.spin()
                outcome = await replacing
                assert outcome.outcome == "done", outcome.because
                # Soon, not when the lease of the old process has expired: the new one would take it for a foreign node.
                await bare.until(lambda: bare.node.get_node_names().count("source") == 1, 10.0)

                done = await finished(result)
                assert done.status == GoalStatus.STATUS_CANCELED and done.result.sequence[-1] == 1000
                assert isinstance(outcome.continuity, Assessments)
                (words,) = (each.words for each in outcome.continuity.found if "goal" in each.words)
                assert "1 goal had not ended after 1 s (`patience`), and cancelling was asked for" in words
                cancelled = await finished(long.cancel_goal_async())
                assert not cancelled.goals_canceling, "the new one does not know that goal"

                fresh = await accepted(100_000)
                await finished(fresh.cancel_goal_async())
                done = await finished(fresh.get_result_async())
                assert done.status == GoalStatus.STATUS_CANCELED and done.result.sequence[-1] == 1002

                result = (await accepted(100_000)).get_result_async()
                ending = asyncio.ensure_future(manager.down())
                done = await finished(result)
                assert done.status == GoalStatus.STATUS_ABORTED and done.result.sequence[-1] == 1002
                await ending
                client.destroy()

    with ended():
        run(main())
