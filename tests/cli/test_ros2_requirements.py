"""`changes require` and locks on real ROS 2: publishers of every QoS are heard, and what is unknown allows nothing."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import EXAMPLES, Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

TOPIC = "/estop/released"


@contextmanager
def other_program(name: str) -> Iterator[Any]:
    """A node of another program, in a context of its own."""
    import rclpy
    from rclpy.context import Context

    context = Context()
    rclpy.init(context=context)
    made = rclpy.create_node(name, context=context)
    try:
        yield made
    finally:
        made.destroy_node()
        rclpy.shutdown(context=context)


@pytest.fixture
def node() -> Iterator[Any]:
    with other_program("estop") as made:
        yield made


def publisher(node: Any, *, latched: bool, type_: str = "Bool") -> Any:
    import std_msgs.msg
    from rclpy.qos import DurabilityPolicy, QoSProfile

    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return node.create_publisher(getattr(std_msgs.msg, type_), TOPIC, QoSProfile(depth=1, durability=durability))


def say(publisher: Any, released: bool) -> None:
    from std_msgs.msg import Bool

    publisher.publish(Bool(data=released))


PROGRAM = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool
rclpy.init()
node = rclpy.create_node("killable")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
publisher = node.create_publisher(Bool, "/estop/released", latched)
publisher.publish(Bool(data=True))
rclpy.spin(node)
"""
# For how long the graph shows a process that was killed (s): Fast DDS's lease.
LEASE = 20.0


@contextmanager
def killable_publisher() -> Iterator[subprocess.Popen[bytes]]:
    program = subprocess.Popen([sys.executable, "-c", PROGRAM])
    try:
        yield program
    finally:
        program.kill()
        program.wait()


def until_status(midstride: Midstride, because: str | None) -> None:
    """Wait until `status` says that the requirement holds (None), or why it does not."""
    deadline = time.monotonic() + 30
    while True:
        [found] = midstride("status", "--json").json["requirements"]
        if (found["because"] is None) if because is None else because in (found["because"] or ""):
            return
        assert time.monotonic() < deadline, found
        time.sleep(0.1)


def test_changes_wait_for_what_they_require(midstride: Midstride, tmp_path: Path, node: Any) -> None:
    folder = tmp_path / "talker"
    shutil.copytree(EXAMPLES / "talker", folder)
    file = folder / "talker.stride"
    file.write_text(f"{file.read_text()}\nchanges require {TOPIC} : std_msgs/msg/Bool where data = true\n")
    latched = publisher(node, latched=True)
    say(latched, True)  # before the manager listens
    assert midstride("up", str(file), "-d").status == 0
    until_status(midstride, None)
    assert "it holds" in midstride("plan", "--restart", "talker").out
    assert midstride("restart", "talker", "--yes").status == 0

    say(latched, False)
    until_status(midstride, "data is False")
    refused = midstride("restart", "talker", "--yes")
    assert refused.status == 1 and f"changes require {TOPIC}" in refused.out and "data is False" in refused.out
    assert midstride("param", "set", "listener", "use_sim_time", "false").status == 1
    assert "data is False" in " ".join(midstride("history").out.split())

    node.destroy_publisher(latched)
    until_status(midstride, "no publisher")
    volatile = publisher(node, latched=False)
    until_status(midstride, "no message has arrived")
    deadline = time.monotonic() + 30
    while midstride("status", "--json").json["requirements"][0]["because"] is not None:
        assert time.monotonic() < deadline
        say(volatile, True)  # until both have found each other
        time.sleep(0.1)
    assert midstride("restart", "talker", "--yes").status == 0

    with other_program("mistaken") as mistaken:
        publisher(mistaken, latched=False, type_="String")
        until_status(midstride, "std_msgs/msg/String is published there")
    # A program that is killed says no more, long before its lease has run out.
    node.destroy_publisher(volatile)
    with killable_publisher() as program:
        until_status(midstride, None)
        program.kill()
        program.wait()
        killed = time.monotonic()
        until_status(midstride, "no publisher")
        assert time.monotonic() - killed < LEASE
    # A lock and the requirement outlive the manager, whose components go on.
    assert midstride("lock", "--reason", "moving", "--by", "alice").status == 0
    components = midstride.components("talker")
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    assert midstride("up", str(file), "-d").status == 0
    assert midstride.components("talker") == components
    assert "locked by alice" in midstride("restart", "talker", "--yes").out
    assert midstride("unlock").status == 0
    assert "changes require" in midstride("restart", "talker", "--yes").out  # it has heard nothing yet
    done = midstride("restart", "talker", "--yes", "--despite-requirements")
    assert done.status == 0 and "although changes require" in " ".join(midstride("history").out.split())
    assert midstride("down").status == 0
