"""Servers of a ROS action in plain rclpy and in C on rcl, a client that has goals in progress, and what both count."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

from tests.acceptance.foreign_support import Robot, declared_talker
from tests.backends.ros2_support import without_midstride
from tests.native import ACTION_LIBRARIES, ACTION_SERVER, compiled

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

# The same with Midstride's API, as a port.
OWN = """
from pathlib import Path
from midstride import Component
from std_msgs.msg import String
from test_msgs.action import Fibonacci

comp = Component("Own")
number = 0
executed = (Path(__file__).parent / "executed").open("a", buffering=1)

def talk():
    global number
    number += 1
    out.write(String(data=f"{comp.instance} {number}"))

async def execute(goal):
    executed.write(f"{bytes(goal.goal_id.uuid).hex()} {comp.instance}\\n")
    result = Fibonacci.Result()
    while len(result.sequence) < goal.request.order and not goal.is_cancel_requested:
        result.sequence.append(len(result.sequence))
        goal.publish_feedback(Fibonacci.Feedback(sequence=result.sequence))
        await comp.clock.sleep(0.05)
    goal.canceled() if goal.is_cancel_requested else goal.succeed()
    return result

out = comp.create_output("out", String)
count = comp.create_action_server("count", Fibonacci, execute)
talking = comp.create_functionality("talk", outputs=[out])
talking.set_normal_mode(talk, rate=50, outputs=[out])
talking.set_degraded_mode(lambda: None)
counting = comp.create_functionality("counting", outputs=[count])
counting.set_normal_mode(lambda: None, outputs=[count])
counting.set_degraded_mode(lambda: None, name="off")
comp.start()
"""

# A bare client with several goals at once, until SIGTERM, each of at least so many numbers; each fourth is cancelled on
# its way. It writes of each: its UUID, the status with which it ended, the lengths of its result and of what it asked
# for, how much feedback came, whether it was to be cancelled, and how long it took until it was accepted, and until it
# had ended (s). A third argument: after how long a goal is given up, which has the status 0 (s).
CLIENT = """
import signal
import sys
import time
import uuid
import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from test_msgs.action import Fibonacci
from unique_identifier_msgs.msg import UUID

rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = Node("asking")
client = ActionClient(node, Fibonacci, "count")
client.wait_for_server()
at_once, least = int(sys.argv[1]), int(sys.argv[2])
patience = float(sys.argv[3]) if len(sys.argv) > 3 else float("inf")
stopped, sent, under_way = [], 0, {}
signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))

class Goal:
    def __init__(self, number):
        self.id, self.order, self.heard = uuid.uuid4(), least + number % 4 * 5, 0
        self.is_to_be_cancelled, self.sent, self.accepted = number % 4 == 0, time.monotonic(), float("nan")
        under_way[self.id] = self
        asked = client.send_goal_async(
            Fibonacci.Goal(order=self.order), self.hear, goal_uuid=UUID(uuid=list(self.id.bytes))
        )
        asked.add_done_callback(self.answered)

    def hear(self, message):
        self.heard += 1

    def answered(self, future):
        self.handle = future.result()
        assert self.handle.accepted
        self.accepted = time.monotonic() - self.sent
        self.handle.get_result_async().add_done_callback(self.ended)
        if self.is_to_be_cancelled:
            self.timer = node.create_timer(0.3, self.cancel)

    def cancel(self):
        self.timer.cancel()
        self.handle.cancel_goal_async()

    def ended(self, future):
        self.note(future.result().status, len(future.result().result.sequence))

    def note(self, status, length):
        if under_way.pop(self.id, None) is not None:
            times = self.accepted, time.monotonic() - self.sent
            print(self.id.hex, status, length, self.order, self.heard, int(self.is_to_be_cancelled), *times, flush=True)

print("ready", flush=True)
while under_way or not stopped:
    if not stopped and len(under_way) < at_once:
        sent += 1
        Goal(sent)
    rclpy.spin_once(node, timeout_sec=0.05)
    for goal in list(under_way.values()):
        if time.monotonic() - goal.sent > patience:
            goal.note(0, 0)
"""
SUCCEEDED, CANCELED = 4, 5


class Ended(NamedTuple):
    """A goal, as its client has seen it end."""

    id: str
    status: int
    length: int
    order: int
    heard: int
    is_to_be_cancelled: bool
    accepted: float  # how long that took (s); not a number: it was not
    took: float


def lines(path: Path) -> list[list[str]]:
    """The words of each line; the last one may be under way."""
    return [line.split() for line in path.read_text().rpartition("\n")[0].splitlines()]


class Goals:
    """What the client has written, and what the servers have."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def ended(self) -> list[Ended]:
        """What has become of each goal, in the order in which that was known."""
        return [
            Ended(id, int(status), int(length), int(order), int(heard), cancelled == "1", float(accepted), float(took))
            for id, status, length, order, heard, cancelled, accepted, took in lines(self._folder / "ended")[1:]
        ]

    @property
    def lost(self) -> list[Ended]:
        return [each for each in self.ended if not each.status]

    @property
    def executed(self) -> list[str]:
        path = self._folder / "executed"
        return [words[0] for words in lines(path)] if path.exists() else []

    @property
    def executed_twice(self) -> list[str]:
        return [id for id, number in Counter(self.executed).items() if number > 1]

    @property
    def wrong(self) -> list[Ended]:
        """The goals with another result than that of what has become of them; none of them has been given up."""
        return [
            each
            for each in self.ended
            if each.status
            and not (each.status == SUCCEEDED and each.length == each.order)
            and not (each.status == CANCELED and each.length < each.order and each.is_to_be_cancelled)
        ]

    def are_executed_once(self, relayed: bool = False) -> None:
        """Each goal was executed by one server, once, and has ended with its result.

        Where it was ``relayed``, the program knows it by another UUID.
        """
        assert not self.executed_twice, f"executed twice: {self.executed_twice}"
        assert not self.lost, f"not ended: {self.lost}"
        assert len(self.ended) == len(self.executed)
        assert relayed or {each.id for each in self.ended} == set(self.executed)
        assert not self.wrong, f"ended with another result: {self.wrong}"
        assert all(each.heard for each in self.ended), "feedback comes from the server that has the goal"


def written(folder: Path) -> Path:
    """A system with a talker that serves an action, and the client, in ``folder``.

    It is a `Plain`, and can become `Other` and `Brief`, both in plain rclpy, and `Native` and `Compiled`, in C on rcl.
    `Brief` waits for its goals for 1 s.
    """
    compiled(folder, ACTION_SERVER, "c_server", ACTION_LIBRARIES)
    (folder / "server.py").write_text(SERVER)
    (folder / "client.py").write_text(CLIENT)
    text = "system serving\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    for name in ("Plain", "Other"):
        text += declared_talker(name, "python3 server.py", "preload")
    text += declared_talker("Brief", "python3 server.py", "preload").replace(" gate", " stop patience 1 s gate")
    for name in ("Native", "Compiled"):
        text += declared_talker(name, "./c_server 20000000", "preload")
    path = folder / "serving.stride"
    path.write_text(f"{text}node talker : Plain {{ out -> /chat }}\n", encoding="utf-8")
    return path


def written_with_api(folder: Path) -> Path:
    """The same system with Midstride's API: an `Own`, which can become `OwnOther`, and the client, in ``folder``."""
    (folder / "own.py").write_text(OWN)
    (folder / "client.py").write_text(CLIENT)
    text = f"""system serving
topic /chat : std_msgs/msg/String @ 50 Hz
action /count : test_msgs/action/Fibonacci
component Own {{
  run "{sys.executable} own.py"
  output out
  action server count
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 50 Hz }}
    mode degraded {{ }}
  }}
  functionality counting {{
    produces count
    mode normal {{ guarantee count : test_msgs/action/Fibonacci }}
    mode off {{ }}
  }}
}}
component OwnOther like Own {{ run "{sys.executable} own.py" }}
node talker : Own {{ out -> /chat  count -> /count }}
"""
    path = folder / "serving.stride"
    path.write_text(text, encoding="utf-8")
    return path


Until = Callable[[Callable[[], bool]], Awaitable[None]]


@asynccontextmanager
async def asking(
    folder: Path, until: Until, order: int, at_once: int = 4, patience: float | None = None
) -> AsyncIterator[Goals]:
    """Meanwhile, a bare client has so many goals in progress, of ``order`` numbers at 20 Hz or a little more.

    ``until`` waits for what is to come true. At the end, each has ended, or was given up after ``patience`` (s).
    """
    with (folder / "ended").open("w") as output:
        numbers = [at_once, order] + ([] if patience is None else [patience])
        command = [sys.executable, str(folder / "client.py"), *map(str, numbers)]
        process = subprocess.Popen(command, stdout=output, env=without_midstride())
        try:
            goals = Goals(folder)
            await until(lambda: len(goals.executed) >= at_once)
            yield goals
            process.send_signal(signal.SIGTERM)
            await until(lambda: process.poll() is not None)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 0


@asynccontextmanager
async def asked(folder: Path, system: Robot, order: int, relayed: bool = False) -> AsyncIterator[Goals]:
    """As :func:`asking`; at the end, all that were sent are judged."""
    async with asking(folder, system.until, order) as goals:
        yield goals
    goals.are_executed_once(relayed)
