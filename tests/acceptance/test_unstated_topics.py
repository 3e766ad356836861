"""Topics that no port states, on real ROS 2: a bare recorder hears one of two plain nodes at any moment."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import groupby, pairwise
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.verdicts.assessment import Assessments
from tests.acceptance.foreign_support import declared_talker, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run, without_midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Plain rclpy: a talker that also broadcasts transforms, of which its component states nothing.
BROADCASTER = """
import os
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = Node("talker")
name, number = os.environ["MIDSTRIDE_INSTANCE"], 0
chatter, moving = node.create_publisher(String, "chatter", 10), node.create_publisher(String, "/tf", 100)
latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
static = node.create_publisher(String, "/tf_static", latched)
own = node.create_publisher(String, "/diagnostics", 10)
for frame in (1, 2, 3):
    static.publish(String(data=f"{name} {frame}"))

def talk():
    global number
    number += 1
    for publisher in (chatter, moving, own):
        publisher.publish(String(data=f"{name} {number}"))

node.create_timer(0.02, talk)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""

# Subscribes with the settings that are usual, and writes what it hears: topic, node, number.
RECORDER = """
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = Node("recorder")
latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
for topic, qos in (("/tf", 10), ("/tf_static", latched), ("/diagnostics", 10)):
    node.create_subscription(String, topic, lambda said, topic=topic: print(topic, said.data, flush=True), qos)
rclpy.spin(node)
"""


class Recorder:
    def __init__(self, path: Path) -> None:
        self._path = path

    def heard(self, topic: str) -> list[tuple[str, int]]:
        """The node and the number of each message, in the order of arrival."""
        whole = self._path.read_text().rpartition("\n")[0]  # the last line may be under way
        found = (line.split() for line in whole.splitlines())
        return [(name, int(number)) for on, name, number in found if on == topic]

    def writers(self, topic: str) -> list[str]:
        return [name for name, _ in groupby(name for name, _ in self.heard(topic))]


@contextmanager
def recorder(folder: Path, name: str) -> Iterator[Recorder]:
    path = folder / name
    with path.open("w") as output:
        process = subprocess.Popen([sys.executable, "-c", RECORDER], stdout=output, env=without_midstride())
        try:
            yield Recorder(path)
        finally:
            process.kill()
            process.wait()


def test_of_two_broadcasters_one_is_heard_and_what_is_latched_is_kept(tmp_path: Path) -> None:
    (tmp_path / "broadcaster.py").write_text(BROADCASTER)
    text = "system frames\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    text += declared_talker("Plain", "python3 broadcaster.py", "preload")
    (tmp_path / "frames.stride").write_text(f"{text}node talker : Plain {{ out -> /chat }}\n")

    async def scenario() -> None:
        async with robot(load(tmp_path / "frames.stride").require(), tmp_path) as system:
            with recorder(tmp_path, "early") as early:
                await system.until(lambda: len(early.heard("/tf")) > 20 and len(early.heard("/tf_static")) == 3)

                def handed_over() -> bool:
                    latest = system.manager.system.life.latest("talker")
                    undeclared = [] if latest is None else latest.state.undeclared
                    return {each.topic for each in undeclared if each.handed_over} == {"/tf", "/tf_static"}

                await system.until(handed_over)
                outcome = await system.meanwhile(system.manager.change(PlanRequest(restart=("talker",))))
                assert outcome.outcome == "done", outcome.because
                await system.until(lambda: early.heard("/tf")[-1][0] == "talker_2")
                count = len(early.heard("/tf"))
                await system.until(lambda: len(early.heard("/tf")) > count + 20)
                await system.until(lambda: ("talker_2", 3) in early.heard("/tf_static"))
                with recorder(tmp_path, "late") as late:
                    await system.until(lambda: len(late.heard("/tf")) > 20)
                    await system.until(partial(lambda late: ("talker_2", 3) in late.heard("/tf_static"), late))
                    assert late.heard("/tf_static") == [("talker_2", frame) for frame in (1, 2, 3)]
            both = ["talker", "talker_2"]
            assert early.writers("/tf") == both, "both have written for a while"
            for name in both:
                numbers = [number for writer, number in early.heard("/tf") if writer == name]
                assert all(before < after for before, after in pairwise(numbers)), "one came twice, or late"
            assert early.heard("/tf_static") == [(name, frame) for name in both for frame in (1, 2, 3)]
            assert len(early.writers("/diagnostics")) > 2, "each process says that of itself, for as long as it runs"
            assert isinstance(outcome.continuity, Assessments)
            said = [each.words for each in outcome.continuity.found if "so both could write" in each.words]
            assert len(said) == 1 and "/diagnostics" in said[0] and "/tf" not in said[0]

    with ended():
        run(scenario())
