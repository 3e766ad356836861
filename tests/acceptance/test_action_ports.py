"""ROS actions as ports of components with the API, on real processes: goals by mode, and across a replacement."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from midstride.lang.load import load
from midstride.model.component import FunctionalityRef
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Counts to the number that a goal asks for, at 20 Hz; 77 is one that it fails at. The last number of a result is 1000
# for an instance without a suffix, 1002 for server_2.
SERVER = """
from midstride import Component
from std_msgs.msg import String
from test_msgs.action import Fibonacci

comp = Component("Server")
number = 0

def talk():
    global number
    number += 1
    out.write(String(data=f"{comp.instance} {number}"))

async def count(goal):
    if goal.request.order == 77:
        raise ValueError("77 is too far")
    result = Fibonacci.Result()
    while len(result.sequence) < goal.request.order and not goal.is_cancel_requested:
        result.sequence.append(len(result.sequence))
        await comp.clock.sleep(0.05)
    goal.canceled() if goal.is_cancel_requested else goal.succeed()
    result.sequence.append(1000 + int(comp.instance.partition("_")[2] or 0))
    return result

out = comp.create_output("out", String)
counter = comp.create_action_server("count", Fibonacci, count, within=0.5, accepts=lambda goal: goal.order != 13)
talking = comp.create_functionality("talk", outputs=[out])
talking.set_normal_mode(talk, rate=50, outputs=[out])
talking.set_degraded_mode(lambda: None)
counting = comp.create_functionality("counting", outputs=[counter])
counting.set_normal_mode(lambda: None, outputs=[counter])
counting.set_degraded_mode(lambda: None, name="off")
comp.start()
"""
# Has one goal of 3 numbers after the other executed, and notes what becomes of each, and the mode.
USER = """
from pathlib import Path

from midstride import Component
from test_msgs.action import Fibonacci

comp = Component("User")
modes = (Path(__file__).parent / "modes").open("a", buffering=1)
count = comp.create_action_client("count", Fibonacci, within=0.5)
use = comp.create_functionality("use", inputs=[count])

async def normal():
    while True:
        handle = await count.send_goal_async(Fibonacci.Goal(order=3))
        result = await handle.get_result_async()
        modes.write(f"normal {result.result.sequence[-1]}\\n")

use.set_normal_mode(normal, inputs=[count])
use.set_degraded_mode(lambda: modes.write("off\\n"), name="off")
comp.start()
"""
TEXT = """system serving
contract Count = test_msgs/action/Fibonacci accepts within 0.5 s
topic /chat : std_msgs/msg/String @ 50 Hz
action /count : Count
component Server {
  run "python3 server.py"
  output out
  action server count
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }  mode degraded { } }
  functionality counting { produces count  mode normal { guarantee count : Count }  mode off { } }
}
component OtherServer like Server { run "python3 server.py" }
component User {
  run "python3 user.py"
  action client count : Count
  functionality use { uses count  mode normal { assume count }  mode off { } }
}
node talker : Server { out -> /chat  count -> /count }
node user : User { count <- /count }
"""


def test_ros_actions_are_ports(tmp_path: Path) -> None:
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    for name, text in (("server.py", SERVER), ("user.py", USER), ("serving.stride", TEXT)):
        (tmp_path / name).write_text(text)

    async def scenario() -> None:
        from action_msgs.msg import GoalStatus
        from action_msgs.srv import CancelGoal
        from rclpy.action import ActionClient
        from test_msgs.action import Fibonacci

        async with robot(load(tmp_path / "serving.stride").require(), tmp_path) as system:
            manager = system.manager
            client = ActionClient(system.bare.node, Fibonacci, "/count")

            async def finished(future: Any) -> Any:
                await system.until(future.done)
                return future.result()

            async def sent(order: int) -> Any:
                return await finished(client.send_goal_async(Fibonacci.Goal(order=order)))

            def seen() -> str:
                found = (tmp_path / "modes").read_text().splitlines()
                return found[-1] if found else ""

            cancelling = system.bare.node.create_client(CancelGoal, "/count/_action/cancel_goal")
            await system.until(lambda: client.server_is_ready() and cancelling.service_is_ready())
            await system.until(lambda: seen() == "normal 1000")
            assert not (await sent(13)).accepted

            # A goal in progress finishes where it was accepted, before that instance ends; the new one executes others.
            result = (await sent(100)).get_result_async()
            asked_late, cancelled, among_all, unfetched = [await sent(order) for order in (100, 9999, 9999, 2)]
            replacing = asyncio.ensure_future(manager.change(PlanRequest(replace=(("talker", "OtherServer"),))))
            await system.until(lambda: seen() == "normal 1002")
            # What is asked about it then is answered there, too.
            late = asked_late.get_result_async()
            reply = await finished(cancelled.cancel_goal_async())
            assert [info.goal_id for info in reply.goals_canceling] == [cancelled.goal_id]
            done = await finished(cancelled.get_result_async())
            assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, 1000)
            for each in (result, late):
                done = await finished(each)
                assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_SUCCEEDED, 1000)
                assert len(done.result.sequence) == 101
            # A request to cancel all goals is answered once, for both instances.
            new = await sent(9999)
            reply = await finished(cancelling.call_async(CancelGoal.Request()))
            found = {bytes(info.goal_id.uuid) for info in reply.goals_canceling}
            assert found >= {bytes(goal.goal_id.uuid) for goal in (among_all, new)}
            done = await finished(new.get_result_async())
            assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, 1002)
            report = await system.meanwhile(replacing)
            assert (report.outcome, report.because) == ("done", None), report.because
            # One instance has ended; the result that no client had fetched, and another one, are known all the same.
            for goal, status in ((unfetched, GoalStatus.STATUS_SUCCEEDED), (among_all, GoalStatus.STATUS_CANCELED)):
                done = await finished(goal.get_result_async())
                assert (done.status, done.result.sequence[-1]) == (status, 1000)
            counted = report.goals["talker"]
            assert (counted.old, counted.new, counted.lost, counted.unknown) == ("talker", "talker_2", 0, 0)
            assert counted.ended_at_old >= 3 and counted.ended_at_new >= 1 and counted.cancelled >= 3
            assert counted.accepted == (
                counted.ended_at_old + counted.ended_at_new + counted.cancelled + counted.in_progress
            )
            assert "goal" not in str(report.continuity), report.continuity

            # A mode that does not serve rejects goals, and those in progress go on.
            goal = await sent(100_000)
            result = goal.get_result_async()
            failing = await sent(77)
            assert (await finished(failing.get_result_async())).status == GoalStatus.STATUS_ABORTED
            await system.until(lambda: manager.configuration.mode(FunctionalityRef("user", "use")).name == "off")
            assert not (await sent(2)).accepted
            await finished(goal.cancel_goal_async())
            done = await finished(result)
            assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, 1002)

            report = await system.meanwhile(manager.change(PlanRequest(restart=("talker",))))
            assert (report.outcome, report.because) == ("done", None)
            assert (await sent(1)).accepted
            client.destroy()

    with ended():
        run(scenario(), 120)
