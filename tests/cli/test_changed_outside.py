"""What was changed outside of Midstride, on real ROS 2: the executable of a package, its overlay, and parameters."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.conftest import Midstride
from tests.cli.test_other_overlay import overlay

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(200)]

MODULE = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

def main():
    rclpy.init()
    node = Node("talk")
    rate = node.declare_parameter("rate", 1.0).value
    publisher = node.create_publisher(String, "out", 10)
    node.create_timer(0.05, lambda: publisher.publish(String(data="word")))
    try:
        rclpy.spin(node)
    except BaseException:
        pass
"""
CONSOLE_SCRIPT = f"""#!{sys.executable}
import sys
from demo_nodes.talk import main
if __name__ == "__main__":
    sys.exit(main())
"""
SET = """
import sys
import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

rclpy.init()
node = rclpy.create_node("set")
client = AsyncParameterClient(node, sys.argv[1])
assert client.wait_for_services(10)
asked = client.set_parameters([Parameter("rate", value=float(sys.argv[2]))])
rclpy.spin_until_future_complete(node, asked, timeout_sec=10)
assert asked.result().results[0].successful
"""
SYSTEM = """
system outside
topic /a : std_msgs/msg/String
topic /b : std_msgs/msg/String
component Packaged {
  run "talk" package "demo" gate preload
  output out
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String }  mode degraded { } }
}
component Script like Packaged { run "python3 own.py" gate preload }
node packaged : Packaged { out -> /a }
node script   : Script   { out -> /b }
"""


def test_what_was_changed_outside_is_seen_and_said(midstride: Midstride, tmp_path: Path) -> None:
    one, other = overlay(tmp_path / "one", "talk"), overlay(tmp_path / "other", "talk")
    (one / "lib" / "demo" / "talk").write_text(CONSOLE_SCRIPT, encoding="utf-8")
    module = one / "modules" / "demo_nodes" / "talk.py"
    module.parent.mkdir(parents=True)
    (module.parent / "__init__.py").touch()
    module.write_text(MODULE, encoding="utf-8")
    (tmp_path / "own.py").write_text(f"{MODULE}\nmain()\n", encoding="utf-8")
    file = tmp_path / "outside.stride"
    file.write_text(SYSTEM, encoding="utf-8")
    installed = os.environ.get("AMENT_PREFIX_PATH", "")
    midstride.environment |= {
        "AMENT_PREFIX_PATH": f"{one}:{installed}".rstrip(":"),
        "PYTHONPATH": f"{one / 'modules'}:{os.environ.get('PYTHONPATH', '')}".rstrip(":"),
    }
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=120)
    assert up.status == 0, up.err
    try:
        what_was_set_is_kept_and_said(midstride, tmp_path)
        # The module behind the executable of a package.
        assert "code changed" not in midstride("status").out
        module.write_text(f"{MODULE}\n# changed\n", encoding="utf-8")
        changed = f"packaged: code changed on disk: {module}"
        assert changed in midstride("status").out
        assert str(module) in midstride("diff", str(file)).out
        # This shell has another overlay before that of the manager.
        overlaid = f"{other}:{midstride.environment['AMENT_PREFIX_PATH']}"
        said = f"packaged: `talk` of package demo is {other}/lib/demo/talk in this shell, and {one}/lib/demo/talk for"
        assert said in " ".join(midstride("status", AMENT_PREFIX_PATH=overlaid).out.split())
        applied = midstride("apply", str(file), "--yes", timeout=60)
        assert applied.status == 0 and changed in applied.out, applied.out + applied.err
        assert "create packaged_2" in applied.out
        assert "code changed" not in midstride("status").out
    finally:
        assert midstride("down", timeout=60).status == 0


def what_was_set_is_kept_and_said(midstride: Midstride, folder: Path) -> None:
    """By any ROS tool, on a node without Midstride's API."""
    shown = "rate = 7.0, set at run time (started with 1.0)"
    deadline = time.monotonic() + 20
    subprocess.run([sys.executable, "-c", SET, "/script", "7"], check=True, cwd=folder, timeout=60)
    while shown not in " ".join(midstride("status").out.split()):
        assert time.monotonic() < deadline, "the status does not show what was set"
        time.sleep(0.2)
    done = midstride("restart", "script", "--yes", timeout=60)
    assert done.status == 0, done.err
    planned = "script: rate = 7.0, set at run time: kept if the program of Script declares it (a request has set it at "
    assert planned in " ".join(done.out.split()), done.out
