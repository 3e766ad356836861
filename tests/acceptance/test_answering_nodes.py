"""Plain nodes that answer messages, on real ROS 2: at a replacement, each message is answered by one of the two."""

from __future__ import annotations

import asyncio
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import Robot, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run, without_midstride
from tests.native import ANSWERER, compiled, environment_of_compiled

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Plain rclpy. With a timer, it publishes what it has heard last instead.
NODE = """
import os
import sys
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node("answerer")
name, last = os.environ["MIDSTRIDE_INSTANCE"], []
publisher = node.create_publisher(String, "answers", 1000)

def answer(said):
    publisher.publish(String(data=f"{name} {said.data.split()[1]}"))

if "timer" in sys.argv:
    node.create_subscription(String, "numbers", last.append, 1000)
    node.create_timer(0.005, lambda: last and answer(last[-1]))
else:
    node.create_subscription(String, "numbers", answer, 1000)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


def answerer(name: str, command: str, rate: str) -> str:
    return f"""component {name} {{
  run "{command}" gate preload
  input in : std_msgs/msg/String as numbers
  output out as answers
  functionality answer {{
    uses in
    produces out
    mode normal   {{ guarantee out : std_msgs/msg/String{rate} }}
    mode degraded {{ }}
  }}
}}
"""


def system(folder: Path, rate: str = "") -> Path:
    """A node `answerer`, at first a `Plain` (rclpy); it can become `Native` (C)."""
    (folder / "answerer.py").write_text(NODE)
    compiled(folder, ANSWERER, "answerer")
    text = f"system answers\ntopic /numbers : std_msgs/msg/String\ntopic /answers : std_msgs/msg/String{rate}\n"
    text += answerer("Plain", "python3 answerer.py", rate)
    text += answerer("Native", "./answerer numbers answers", rate)
    text += answerer("Timed", "python3 answerer.py timer", rate)
    path = folder / "answers.stride"
    path.write_text(f"{text}node answerer : Plain {{ in <- /numbers  out -> /answers }}\n")
    return path


@contextmanager
def counter(folder: Path, rate: float) -> Iterator[None]:
    """A node of no system that writes "c_talker NUMBER" on /numbers."""
    program = compiled(folder)
    command = [str(program), f"{1e9 / rate:.0f}", "/numbers"]
    with subprocess.Popen(command, env=environment_of_compiled(without_midstride())) as process:
        try:
            yield
        finally:
            process.kill()


def answered_once(robot: Robot) -> None:
    """Each number from the first to the last that were heard has one answer."""
    numbers = Counter(number for _, _, number in robot.heard)
    first, last = min(numbers), max(numbers) - 20  # the last ones may be on the way
    wrong = {number: numbers[number] for number in range(first, last) if numbers[number] != 1}
    assert not wrong, f"number: how many answers: {wrong}; {robot.changes()}"


async def said_of_answers(robot: Robot, component: str) -> list[str]:
    """What a plan says of them, once the node has reported some."""
    while True:
        plan = await robot.manager.plan(PlanRequest(replace=(("answerer", component),)))
        if found := [each for each in plan.remarks or () if "answered" in each]:
            return found
        await asyncio.sleep(0.1)


def by_input(robot: Robot) -> list[str]:
    """What the events say of the hand-overs between two inputs."""
    found = [event.words for event in robot.manager.events.since(0) if event.kind == "note"]
    return [words for words in found if words.endswith("between two messages: each was answered by one of them")]


@pytest.mark.parametrize(
    ("rate", "components"),
    [
        pytest.param("", ("Native", "Plain"), id="without a rate"),
        pytest.param("", ("Plain", "Native", "Native"), id="of one kind", marks=pytest.mark.long),
        pytest.param(" @ 180 Hz", ("Plain", "Native", "Native", "Plain"), id="with a rate", marks=pytest.mark.long),
    ],
)
def test_each_message_is_answered_once(tmp_path: Path, rate: str, components: tuple[str, ...]) -> None:
    path = system(tmp_path, rate)

    async def scenario() -> None:
        with counter(tmp_path, 200):
            async with robot(load(path).require(), tmp_path, topic="/answers", in_c=True) as system:
                for component in components:
                    await system.replaced(component, role="answerer")
                await system.hears(50)
                answered_once(system)
                assert len(system.changes()) == len(components)
                assert len(by_input(system)) == len(components)

    with ended():
        run(scenario())


def test_a_timer_that_publishes_the_last_input_does_not_answer_it(tmp_path: Path) -> None:
    path = system(tmp_path, " @ 180 Hz")

    async def scenario() -> None:
        with counter(tmp_path, 200):
            async with robot(load(path).require(), tmp_path, topic="/answers", in_c=True) as system:
                remarks = []
                for component in ("Timed", "Plain"):
                    remarks.append(await said_of_answers(system, component))
                    await system.replaced(component, role="answerer")
                assert remarks == [
                    [
                        "each message that answerer answers is answered by one of answerer and answerer_2, if "
                        "answerer_2 is seen to answer each as well, behind its gate"
                    ],
                    [
                        "a message may be answered by both answerer_2 and answerer_3, or by neither: answerer_2 is not "
                        "seen to publish one message for each that it takes, in the thread that has taken it"
                    ],
                ]
                assert not by_input(system)

    with ended():
        run(scenario())
