"""ROS actions of nodes without Midstride's API across replacements: every goal ends with its result, as clients count.

MIDSTRIDE_REPLACEMENTS says how many replacements the long test makes, where 100 take too long.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from midstride.foreign import gated_outputs
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.verdicts import Assessments
from tests.acceptance.foreign_support import Robot, declared_talker, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run, without_midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_REPLACEMENTS", "100"))

# Plain rclpy: it talks, counts to the number that a goal asks for at 20 Hz, and notes each goal that it executes.
SERVER = """
import os
import time
import rclpy
from pathlib import Path
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String
from test_msgs.action import Fibonacci

rclpy.init()
node = Node("talker")
name, number = os.environ["MIDSTRIDE_INSTANCE"], 0
publisher = node.create_publisher(String, "chatter", 10)
executed = (Path(__file__).parent / "executed").open("a", buffering=1)

def talk():
    global number
    number += 1
    publisher.publish(String(data=f"{name} {number}"))

def count(goal):
    executed.write(f"{bytes(goal.goal_id.uuid).hex()} {name}\\n")
    result = Fibonacci.Result()
    while len(result.sequence) < goal.request.order and not goal.is_cancel_requested:
        result.sequence.append(len(result.sequence))
        goal.publish_feedback(Fibonacci.Feedback(sequence=result.sequence))
        time.sleep(0.05)
    goal.canceled() if goal.is_cancel_requested else goal.succeed()
    return result

node.create_timer(0.02, talk)
ActionServer(node, Fibonacci, "count", count, cancel_callback=lambda goal: CancelResponse.ACCEPT,
             callback_group=ReentrantCallbackGroup())
try:
    rclpy.spin(node, MultiThreadedExecutor(12))
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""

# A bare client with several goals at once, until SIGTERM; each fourth is cancelled on its way. It writes of each: UUID,
# the status with which it ended, the lengths of its result and of what it asked for, and how much feedback came.
CLIENT = """
import signal
import sys
import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from test_msgs.action import Fibonacci

rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = Node("asking")
client = ActionClient(node, Fibonacci, "count")
client.wait_for_server()
stopped, sent, under_way = [], 0, set()
signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))

def send():
    global sent
    sent += 1
    number, order, heard = sent, 15 + sent % 4 * 5, []
    under_way.add(number)
    asked = client.send_goal_async(Fibonacci.Goal(order=order), lambda message: heard.append(message))

    def answered(future):
        goal = future.result()
        assert goal.accepted

        def ended(future):
            result = future.result()
            words = bytes(goal.goal_id.uuid).hex(), result.status, len(result.result.sequence), order, len(heard)
            print(*words, flush=True)
            under_way.discard(number)

        goal.get_result_async().add_done_callback(ended)
        if number % 4 == 0:
            timer = node.create_timer(0.3, lambda: (timer.cancel(), goal.cancel_goal_async()))

    asked.add_done_callback(answered)

print("ready", flush=True)
while under_way or not stopped:
    if not stopped and len(under_way) < int(sys.argv[1]):
        send()
    rclpy.spin_once(node, timeout_sec=0.05)
"""
SUCCEEDED, CANCELED = 4, 5


class Ended(NamedTuple):
    """A goal, as its client has seen it end."""

    id: str
    status: int
    length: int
    order: int
    heard: int


def lines(path: Path) -> list[list[str]]:
    """The words of each line; the last one may be under way."""
    return [line.split() for line in path.read_text().rpartition("\n")[0].splitlines()]


class Goals:
    """What the client has written, and what the servers have."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def ended(self) -> list[Ended]:
        return [Ended(id, *map(int, rest)) for id, *rest in lines(self._folder / "ended")[1:]]

    @property
    def executed(self) -> list[str]:
        path = self._folder / "executed"
        return [words[0] for words in lines(path)] if path.exists() else []

    def are_executed_once(self) -> None:
        """Each goal was executed by one server, once, and has ended with its result."""
        twice = [id for id, number in Counter(self.executed).items() if number > 1]
        assert not twice, f"executed twice: {twice}"
        assert {each.id for each in self.ended} == set(self.executed)
        for each in self.ended:
            assert each.status == SUCCEEDED or (each.status == CANCELED and each.length < each.order), each
            assert each.status == CANCELED or each.length == each.order, each
        assert all(each.heard for each in self.ended), "feedback comes from the server that has the goal"


def written(folder: Path) -> Path:
    """A system with a talker that serves an action, and the client, in ``folder``."""
    (folder / "server.py").write_text(SERVER)
    (folder / "client.py").write_text(CLIENT)
    text = "system serving\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    for name in ("Plain", "Other"):
        text += declared_talker(name, "python3 server.py", "preload")
    path = folder / "serving.stride"
    path.write_text(f"{text}node talker : Plain {{ out -> /chat }}\n", encoding="utf-8")
    return path


@asynccontextmanager
async def asked(folder: Path, system: Robot, at_once: int = 4) -> AsyncIterator[Goals]:
    """Meanwhile, a bare client has so many goals in progress. At the end, all that were sent are judged."""
    with (folder / "ended").open("w") as output:
        command = [sys.executable, str(folder / "client.py"), str(at_once)]
        process = subprocess.Popen(command, stdout=output, env=without_midstride())
        try:
            goals = Goals(folder)
            await system.until(lambda: len(goals.executed) >= at_once)
            yield goals
            process.send_signal(signal.SIGTERM)
            await system.until(lambda: process.poll() is not None)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 0
    goals.are_executed_once()


async def cut_short(system: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal that does not end in time is cancelled, and its client gets what it has come to; the report says so."""
    from rclpy.action import ActionClient
    from test_msgs.action import Fibonacci

    monkeypatch.setattr(gated_outputs, "GOAL_PATIENCE", 1.0)
    client: Any = ActionClient(system.bare.node, Fibonacci, "/count")
    await system.until(client.server_is_ready)
    asked = client.send_goal_async(Fibonacci.Goal(order=100_000))
    await system.until(asked.done)
    result = asked.result().get_result_async()
    outcome = await system.change("Plain")
    await system.until(result.done)
    assert result.result().status == CANCELED and result.result().result.sequence
    assert outcome.outcome == "done" and isinstance(outcome.continuity, Assessments)
    (words,) = (each.words for each in outcome.continuity.found if "goal" in each.words)
    assert "1 goal of ROS action /count had not ended after 1 s (`patience`), and cancelling was asked for" in words
    client.destroy()


def replaced_often(folder: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the server under goals in progress."""
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")

    async def scenario() -> None:
        async with robot(load(written(folder)).require(), folder) as system:
            async with asked(folder, system) as found:
                for count in range(number):
                    component = "Plain" if count % 2 else "Other"
                    planned = await system.manager.plan(PlanRequest(replace=(("talker", component),)))
                    (goals,) = (each.words for each in planned.besides if each.words.startswith("goals of others"))
                    assert "ROS action /count: they go on at talker" in goals and "for at most 60 s" in goals
                    outcome = await system.change(component)
                    assert (outcome.outcome, outcome.because) == ("done", None)
                    assert "goal" not in str(outcome.continuity), outcome.continuity
            assert len(system.changes()) == number
            assert system.holes() == []
            await cut_short(system, monkeypatch)
            ways = Counter(each.status for each in found.ended)
            print(f"{len(found.ended)} goals, {ways[SUCCEEDED]} succeeded, {ways[CANCELED]} were cancelled")
            assert ways[SUCCEEDED] and ways[CANCELED]

    with ended():
        run(scenario(), 3600)


def test_every_goal_is_executed_once_across_replacements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replaced_often(tmp_path, 2, monkeypatch)


@pytest.mark.long
def test_every_goal_is_executed_once_across_many_replacements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replaced_often(tmp_path, REPLACEMENTS, monkeypatch)
