"""How nodes without Midstride's API end, and how late they may begin, on real ROS 2: by the commands of a user."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.cli.conftest import Midstride, alive

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(200)]

TALKER = """
import rclpy
from std_msgs.msg import String

def talker(node, topic="out"):
    publisher = node.create_publisher(String, topic, 10)
    node.create_timer(0.05, lambda: publisher.publish(String(data="word")))
    return node
"""

# Saves on Ctrl-C only, as a program that catches KeyboardInterrupt; or needs 3.5 s to save; or takes no notice of any
# signal, and has started a process in a session of its own.
SAVER = """
import os, signal, subprocess, sys, time
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from talk import talker

rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
kind = sys.argv[1]
if kind == "stubborn":
    child = subprocess.Popen(["sleep", "600"], start_new_session=True)
    open(f"child.{child.pid}", "w").close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
node = talker(Node("saver"))
try:
    while True:
        rclpy.spin_once(node, timeout_sec=0.05)
except KeyboardInterrupt:
    time.sleep(3.5 if kind == "slow" else 0.0)
open(f"saved.{kind}.{os.getpid()}", "w").close()
"""

ENDING = """
system ending
topic /a : std_msgs/msg/String
topic /b : std_msgs/msg/String
topic /c : std_msgs/msg/String
component Saver {
  run "python3 saver.py prompt" gate preload
  output out
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String }  mode degraded { } }
}
component Slow like Saver { run "env A=b python3 saver.py slow" gate preload }
component Stubborn like Saver { run "python3 saver.py stubborn" stop sigterm 300 ms sigkill 200 ms gate preload }
node a : Saver    { out -> /a }
node b : Slow     { out -> /b }
node c : Stubborn { out -> /c }
"""

# A model is loaded for so long.
MODEL = """
import sys, time
import rclpy
from rclpy.node import Node
from talk import talker

rclpy.init()
node = Node("model")
time.sleep(float(sys.argv[1]))
rclpy.spin(talker(node))
"""

# Has a publisher only while something subscribes.
LAZY = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node("lazy")
publisher = None
topic = node.resolve_topic_name("out")

def look():
    global publisher
    wanted = node.count_subscribers(topic) > 0
    if wanted and publisher is None:
        publisher = node.create_publisher(String, topic, 10)
    elif not wanted and publisher is not None:
        node.destroy_publisher(publisher)
        publisher = None
    if publisher is not None:
        publisher.publish(String(data="word"))

node.create_timer(0.05, look)
rclpy.spin(node)
"""

# Says that it has heard something, and subscribes until a capture has looked on for 2 s.
HEAR = """
import sys, time
import rclpy
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("hear")
node.create_subscription(String, sys.argv[1], lambda message: open("heard", "w").close(), 10)
since = None
while since is None or time.monotonic() < since + 2.0:
    rclpy.spin_once(node, timeout_sec=0.05)
    if since is None and "_midstride_capture" in node.get_node_names():
        since = time.monotonic()
"""

LATE = """
system late
topic /model : std_msgs/msg/String
topic /lazy : std_msgs/msg/String
component Model {
  run "python3 model.py 6" takes 10 s gate preload
  output out
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String }  mode degraded { } }
}
component Lazy like Model { run "python3 lazy.py" gate preload  output out lazy }
node model : Model { out -> /model }
node lazy  : Lazy  { out -> /lazy }
"""


def files(folder: Path, **texts: str) -> None:
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")


def saved(folder: Path) -> Sequence[str]:
    """The kinds of the nodes that have saved, one for each process."""
    return sorted(path.name.split(".")[1] for path in folder.glob("saved.*"))


def test_nodes_end_as_launch_ends_them_and_what_had_to_be_killed_is_said(midstride: Midstride, tmp_path: Path) -> None:
    files(tmp_path, talk=TALKER, saver=SAVER)
    file = tmp_path / "ending.stride"
    file.write_text(ENDING, encoding="utf-8")
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=120)
    assert up.status == 0, up.err
    changed = midstride("restart", "a", "b", "c", "--yes", timeout=120)
    assert changed.status == 0, changed.err
    assert saved(tmp_path) == ["prompt", "slow"], "one that ends on SIGINT, and one that needs longer than 3 s"
    words = "c had not ended 0.5 s after it was asked to, and was killed (SIGKILL)"
    said = " ".join(f"{changed.out}{changed.err}".split())
    assert words in said and "SIGKILL" not in said.replace(words, ""), said
    assert words in " ".join(midstride("log", "-a").out.split())
    children = [int(path.name.split(".")[1]) for path in tmp_path.glob("child.*")]
    assert len(children) == 2 and sum(alive(pid) for pid in children) == 1, "that of the node that has ended is gone"
    down = midstride("down", timeout=60)
    assert down.status == 0, down.err
    assert "c_2 had not ended 0.5 s after it was asked to" in " ".join(down.out.split())
    assert saved(tmp_path) == ["prompt", "prompt", "slow", "slow"]
    assert not any(alive(pid) for pid in children)


def test_a_slow_start_and_a_lazy_output_are_waited_for_as_stated(midstride: Midstride, tmp_path: Path) -> None:
    """Its endpoints come 6 s after its start, 4 s are given to any node here, and it states 10 s more.

    Meanwhile, capture proposes that an output is lazy which it has seen to go with its last subscription.
    """
    files(tmp_path, talk=TALKER, model=MODEL, lazy=LAZY, hear=HEAR)
    file = tmp_path / "late.stride"
    file.write_text(LATE, encoding="utf-8")
    midstride.environment["MIDSTRIDE_ENDPOINTS_TIMEOUT"] = "4"
    begun = time.monotonic()
    up = midstride.start("up", str(file), "-d", "--backend", "ros2")
    by_hand = ["lazy.py", "--ros-args", "-r", "__node:=by_hand", "-r", "out:=/by_hand"]
    others = [subprocess.Popen([sys.executable, *words], cwd=tmp_path) for words in (by_hand, ["hear.py", "/by_hand"])]
    try:
        deadline = time.monotonic() + 60
        while not (tmp_path / "heard").exists():
            assert time.monotonic() < deadline, "nothing was heard"
            time.sleep(0.05)
        captured = midstride.process("capture", "--seconds", "10", timeout=60)
    finally:
        for other in others:
            other.kill()
            other.wait()
    assert captured.status == 0 and "output by_hand lazy" in captured.out, captured.out + captured.err
    out, _ = up.communicate(timeout=120)
    assert up.returncode == 0, out
    assert time.monotonic() - begun > 6.0
    assert midstride("status").status == 0
    assert midstride("down", timeout=60).status == 0
