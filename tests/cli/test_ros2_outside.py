"""A system on real ROS 2 beside other nodes, whose manager is killed, and that has a request under way."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(200)]

PLAIN = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node("plain")
publisher = node.create_publisher(String, "out", 10)
count = 0

def tick():
    global count
    count += 1
    if {raises} and count > 1:
        raise ValueError("the filter has no input")
    publisher.publish(String(data="word"))

node.create_timer(0.1, tick)
rclpy.spin(node)
"""
# With Midstride's API: an `async` service that takes 4 s.
ASKED = """
from midstride import Component
from rcl_interfaces.srv import ListParameters
from rclpy.task import Future
from std_msgs.msg import String

comp = Component("asked")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])
work.set_normal_mode(lambda: out.write(String(data="x")), rate=20, outputs=[out])
work.set_degraded_mode(lambda: None)

@comp.on_setup
def set_up(node):
    async def ask(request, response):
        waited = Future(executor=node.executor)
        timer = node.create_timer(4.0, lambda: waited.done() or waited.set_result(None))
        await waited
        timer.cancel()
        response.result.names = [comp.instance]
        return response

    node.create_service(ListParameters, "~/ask", ask)

comp.start()
"""
# Nodes with the names of the instances that replace others, one of which listens; and a client.
OTHERS = """
import sys
import rclpy
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

rclpy.init()
others = [rclpy.create_node("plain_2"), rclpy.create_node("asked_2")]
listening = others[0].create_subscription(String, "/words", lambda message: None, 10)
client = others[1].create_client(ListParameters, "/asked/ask")
assert client.wait_for_service(20)
asked = client.call_async(ListParameters.Request())
print("asked", flush=True)
rclpy.spin_until_future_complete(others[1], asked, timeout_sec=30)
print(asked.result().result.names[0] if asked.done() else "no answer", flush=True)
sys.stdin.read()
"""
SYSTEM = """
system beside
contract Words = std_msgs/msg/String @ 10 Hz
topic /words : Words
topic /x     : std_msgs/msg/String @ 20 Hz
component Plain {
  run "python3 plain.py" gate preload
  output out
  functionality talk { produces out  mode normal { guarantee out : Words }  mode degraded { } }
}
component Raising like Plain { run "python3 raising.py" gate preload }
component Asked {
  run "python3 asked.py"
  allows service ~/ask
  output out
  functionality work {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
}
node plain : Plain { out -> /words }
node asked : Asked { out -> /x }
"""


def test_nodes_outside_an_exception_a_request_and_another_domain(midstride: Midstride, tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text(PLAIN.format(raises=False))
    (tmp_path / "raising.py").write_text(PLAIN.format(raises=True))
    (tmp_path / "asked.py").write_text(ASKED)
    (tmp_path / "others.py").write_text(OTHERS)
    file = tmp_path / "beside.stride"
    file.write_text(SYSTEM)
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=120)
    assert up.status == 0, up.out + up.err
    try:
        assert "/words: plain.out → no subscriber" in midstride("status").out
        with subprocess.Popen(
            [sys.executable, str(tmp_path / "others.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as others:
            try:
                names_are_free_and_a_request_is_answered(midstride, others)
            finally:
                others.kill()
        the_exception_of_a_replacement_is_shown(midstride)
        another_domain_is_refused(midstride, file)
    finally:
        assert midstride("down", timeout=60).status == 0


def the_exception_of_a_replacement_is_shown(midstride: Midstride) -> None:
    """It raises behind its gate: with rclpy's own executor, its process ends."""
    replaced = midstride("replace", "plain", "Raising", "--yes", timeout=60)
    assert replaced.status == 1
    # On a busy machine, before the manager has accepted it.
    exited = (
        r"plain_3 exited with status 1( before it (registered|was accepted))?: ValueError: the filter has no input\n"
    )
    assert re.search(exited, replaced.out), replaced.out
    assert 'raise ValueError("the filter has no input")' in replaced.out
    logs = midstride("logs", "plain")
    assert (logs.status, logs.out) == (0, "") and "`midstride logs plain_3`" in logs.err
    assert midstride("logs", "plain_3").out.endswith("ValueError: the filter has no input\n")


def names_are_free_and_a_request_is_answered(midstride: Midstride, others: subprocess.Popen[str]) -> None:
    assert others.stdout is not None
    assert others.stdout.readline() == "asked\n"
    until(lambda: "/words: plain.out → /plain_2 (not in the specification)" in midstride("status").out)
    for node in ("asked", "plain"):
        restarted = midstride("restart", node, "--yes", timeout=60)
        assert restarted.status == 0, restarted.out + restarted.err
    assert others.stdout.readline() == "asked\n", "the old instance has answered"
    nodes = {each["role"]: each["node"] for each in midstride("status", "--json").json["instances"]}
    assert nodes == {"asked": "/asked", "plain": "/plain"}, "each keeps its name"


def another_domain_is_refused(midstride: Midstride, file: Path) -> None:
    os.kill(midstride.manager("beside"), signal.SIGKILL)
    here = os.environ.get("ROS_DOMAIN_ID") or "0"
    other = str((int(here) + 1) % 100)
    refused = midstride("up", str(file), "-d", "--backend", "ros2", timeout=60, ROS_DOMAIN_ID=other)
    assert refused.status == 1
    assert f"run with ROS_DOMAIN_ID={here}, and this manager has ROS_DOMAIN_ID={other}, so it would" in refused.err
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=60, ROS_DOMAIN_ID=here)
    assert up.status == 0 and "was reattached unchanged" in up.out, up.out + up.err


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.2)
