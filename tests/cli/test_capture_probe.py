"""`midstride capture --probe` on plain rclpy nodes, from a launch file to a specification that states what depends."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.model.component import InputAlternatives
from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(400)]

# The node that its argument names.
PROGRAM = """
import sys, time
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

kind = sys.argv[1]
rclpy.init()
node = Node(kind)
heard = {}

def output(topic, rate=None, needs=None):
    publisher = node.create_publisher(String, topic, 10)

    def publish(_=None):
        if needs is None or time.monotonic() - heard.get(needs, -1.0) < 0.4:
            publisher.publish(String(data=topic))

    if rate is not None:
        node.create_timer(1 / rate, publish)
    return publish

def take(topic, then=None):
    def hear(message):
        heard[topic] = time.monotonic()
        if then is not None:
            then(message)
    node.create_subscription(String, topic, hear, 10)

if kind == "sensor":
    output("scan", 20.0)
    output("tick", 10.0)
elif kind == "filter":
    take("scan", output("edges"))
elif kind == "mixer":
    output("cmd", 20.0, "edges")
    take("edges")
    take("tick", output("beat"))
    output("alive", 10.0)
else:
    take("cmd")
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


def test_what_depends_on_what_is_found_in_running_nodes(midstride: Midstride, tmp_path: Path) -> None:
    program, launch, file = tmp_path / "node.py", tmp_path / "robot.launch.xml", tmp_path / "robot.stride"
    program.write_text(PROGRAM, encoding="utf-8")
    kinds = ("sensor", "filter", "mixer", "wheels")
    nodes = [f'<executable cmd="{sys.executable} {program} {kind}" name="{kind}"/>' for kind in kinds]
    launch.write_text(f"<launch>{''.join(nodes)}</launch>", encoding="utf-8")
    imported = midstride("import", str(launch), "-o", str(file))
    assert imported.status == 0, imported.err
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=120)
    assert up.status == 0, up.err
    try:
        found = midstride(
            "capture", "--into", str(file), "--seconds", "3", "--probe", "--probe-seconds", "2.5", "--yes", timeout=240
        )
    finally:
        assert midstride("down", timeout=60).status == 0
    print(found.err, file.read_text(encoding="utf-8"))
    assert found.status == 0, found.err
    assert "4 nodes in " in found.err and "wheels" not in found.err
    system = load(file).require()
    needs = {
        (role, output, name)
        for role, node in system.nodes.items()
        for functionality in system.components[node.component]
        for output in functionality.outputs
        for assumption in functionality.modes[0].assumptions
        for name in (assumption.inputs if isinstance(assumption, InputAlternatives) else ())
    }
    assert needs == {("filter", "edges", "scan"), ("mixer", "cmd", "edges"), ("mixer", "beat", "tick")}
