"""Nodes without Midstride's API on another host: their gates, their page and their agents are there."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from midstride.runtime.process.reaper import process_info
from tests.hosts.robots import Robot, robots

pytestmark = [pytest.mark.ros2, pytest.mark.hosts, pytest.mark.long, pytest.mark.timeout(300)]

SYSTEM = """system chat

topic /chat : std_msgs/msg/String @ 50 Hz

component Talker {
  run "python3 talker.py" gate preload
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
}

component NewTalker like Talker { run "python3 ./talker.py" gate preload }

component Listener {
  run "python3 listener.py" gate preload
  input in : std_msgs/msg/String @ 50 Hz as chatter
  functionality listen {
    uses in
    mode normal { assume in }
    mode degraded { }
  }
}

node talker   : Talker on arm { out -> /chat }
node listener : Listener on arm { in <- /chat }
node here     : Listener { in <- /chat }
"""
PROGRAM = """
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node({name!r})
{body}
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
TALK = """
publisher = node.create_publisher(String, "chatter", 10)
node.create_timer(0.02, lambda: publisher.publish(String(data="hello")))
"""
LISTEN = """
node.create_subscription(String, "chatter", lambda message: node.get_logger().info(message.data), 10)
"""


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    (tmp_path / "talker.py").write_text(PROGRAM.format(name="talker", body=TALK))
    (tmp_path / "listener.py").write_text(PROGRAM.format(name="listener", body=LISTEN))
    with robots(tmp_path, SYSTEM) as robot:
        yield robot


def test_they_are_started_replaced_and_ended_there_and_go_on_without_their_host_process(robot: Robot) -> None:
    up = robot("up", robot.file, "-d")
    assert up.status == 0, up.out + up.err
    assert (robot.workspace / "components" / "gates" / "page").exists()
    before = {each["name"]: each["pid"] for each in robot.status["instances"]}
    assert all(f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}" in _environment(pid) for pid in before.values())
    replaced = robot("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0 and replaced.json["outcome"] == "done", replaced.out + replaced.err
    assert {each["subscriber"]: each["missed"] for each in replaced.json["swaps"]} == {"here.in": 0, "listener.in": 0}
    talker = robot.instance("talker")
    assert (talker["name"], talker["host"]) == ("talker_2", "arm")
    robot.until(lambda: process_info(before["talker"]) is None, "the old one has ended")

    # Nobody answers for them while their host process is gone; they go on, and the next one finds them.
    found = process_info(talker["pid"])
    assert found is not None
    os.kill(robot.host_process, signal.SIGKILL)
    robot.until(lambda: not robot.instance("talker")["reachable"], "nobody answers for them")
    robot.until(lambda: bool(robot.instance("talker")["reachable"]), "the next one answers for them")
    still = process_info(talker["pid"])
    assert robot.status["crashed"] == [] and still is not None and still.started == found.started
    robot.until(lambda: robot.status["condition"]["state"] == "up", "all is as it was")
    replaced = robot("replace", "talker", "Talker", "--yes", "--json")
    assert replaced.status == 0 and replaced.json["outcome"] == "done", replaced.out + replaced.err

    pids = [each["pid"] for each in robot.status["instances"]]
    assert robot("down").status == 0
    assert not any((info := process_info(pid)) is not None and info.alive for pid in pids)


def _environment(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/environ").read_bytes().decode(errors="replace").split("\0")
