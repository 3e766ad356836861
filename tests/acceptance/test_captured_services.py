"""Two plain rclpy nodes that call each other: captured from the live graph, checked, brought up, and missed."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import pytest

from midstride.capture.insertion import insert
from midstride.capture.observed import ObservedGraph
from midstride.lang.load import load_text
from midstride.model.component import FunctionalityRef
from tests.acceptance.foreign_support import robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run
from tests.capture.test_capture import checked
from tests.capture.test_captured_services import attached

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Talks, serves, and has goals for the other one; nothing calls `unused`.
TALKER = """
import os
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci

rclpy.init()
node, number = Node("talker"), 0
publisher = node.create_publisher(String, "chatter", 10)

def talk():
    global number
    number += 1
    publisher.publish(String(data=f"{os.environ['MIDSTRIDE_INSTANCE']} {number}"))

node.create_timer(0.02, talk)
servers = [node.create_service(Trigger, name, lambda _, response: response) for name in ("~/count", "unused")]
goals = ActionClient(node, Fibonacci, "dock")
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
USER = """
import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci

rclpy.init()
node = Node("user")
client = node.create_client(Trigger, "number")
actions = ActionServer(node, Fibonacci, "dock", lambda goal: Fibonacci.Result())
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
TEXT = """system called

component Talker { run "python3 talker.py" gate preload }
component User { run "python3 user.py --ros-args -r number:=/talker/count" gate preload }

node talker : Talker
node user   : User
"""


def complete(graph: ObservedGraph) -> bool:
    heard = [graph.times(each) for each in graph.publishers("/chatter")]
    return len(graph.services) == 5 and bool(heard) and len(heard[0] or ()) > 10


def test_nodes_that_call_each_other_are_captured_and_brought_up(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("before", "after")]
    for folder in folders:
        folder.mkdir()
        (folder / "talker.py").write_text(TALKER)
        (folder / "user.py").write_text(USER)

    async def captured() -> str:
        from midstride.backends.ros2.manager.observer import observe

        async with robot(load_text(TEXT).require(), folders[0], "/chatter") as system:
            nodes = ["/talker", "/user"]
            graph = await system.meanwhile(asyncio.to_thread(observe, 60.0, nodes, complete))
            return insert(TEXT, "called.stride", graph).text

    async def scenario() -> None:
        text = await captured()
        specification = checked(text, folders[1])
        assert attached(specification) == {
            "/talker/count": {"talker.count ->", "user.count <-"},
            "/dock": {"user.dock ->", "talker.dock <-"},
        }
        assert "# no port for service /unused: no other node here calls it" in text
        assert specification.components["User"].topic_of("count") == "number"
        async with robot(specification, folders[1], "/chatter") as system:
            configuration = system.manager.configuration
            assert {configuration.mode(ref).name for ref in configuration.modes} == {"normal"}
            assert {str(ref) for ref in configuration.modes} == {
                "talker.main", "talker.serve", "talker.call", "user.serve", "user.call",
            }  # fmt: skip
            (user,) = (each for each in (await system.manager.status()).instances if each.role == "user")
            assert user.pid is not None
            os.kill(user.pid, signal.SIGKILL)

            def mode(name: str) -> str:
                return system.manager.configuration.mode(FunctionalityRef("talker", name)).name

            await system.until(lambda: mode("call") == "degraded")
            assert (mode("main"), mode("serve")) == ("normal", "normal")

    with ended():
        run(scenario(), 120)
