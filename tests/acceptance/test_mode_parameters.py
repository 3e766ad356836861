"""A node in plain rclpy whose modes are sets of parameters: it gets them as a whole, and may refuse them."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from midstride import backends
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run
from tests.test_ament_index import planted

pytestmark = [pytest.mark.ros2, pytest.mark.full]

PROGRAM = """
import os
import sys
import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node("node")
if sys.argv[1] == "lidar":
    out = node.create_publisher(String, "scan", 10)
    node.create_timer(0.05, lambda: out.publish(String(data="scan")))
else:
    node.declare_parameter("speed", 9.0)
    node.declare_parameter("gain", 9)
    out = node.create_publisher(String, "cmd", 10)
    scan = node.create_subscription(String, "scan", lambda message: None, 10)

    def check(parameters):
        return SetParametersResult(successful=not os.path.exists("refuse"), reason="the driver is locked")

    def drive():
        speed, gain = (node.get_parameter(name).value for name in ("speed", "gain"))
        out.publish(String(data=f"{speed} {gain}"))

    node.add_on_set_parameters_callback(check)
    node.create_timer(0.05, drive)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""

TEXT = """system drive

topic /scan : std_msgs/msg/String @ 20 Hz
topic /cmd  : std_msgs/msg/String @ 20 Hz

component Lidar {
  run "start lidar" package "drive_nodes" gate preload
  output scan
  functionality sense {
    produces scan
    mode normal { guarantee scan : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
}

component Driver {
  run "python3 node.py driver" gate preload
  parameters { speed = 1.0, gain = 2 }
  input  scan : std_msgs/msg/String @ 20 Hz
  output cmd
  functionality drive {
    uses scan
    produces cmd
    mode normal {
      assume scan
      guarantee cmd : std_msgs/msg/String @ 20 Hz
    }
    mode slow {
      parameters { speed = 0.25, gain = 5 }
      guarantee cmd : std_msgs/msg/String @ 20 Hz
    }
    mode degraded { }
  }
}

node lidar  : Lidar  { scan -> /scan }
node driver : Driver { scan <- /scan   cmd -> /cmd }
"""


@pytest.mark.parametrize("gate", ["preload", "relay"])
def test_a_mode_sets_parameters_and_one_that_is_refused_is_not_entered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gate: str
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", planted(tmp_path / "prefix", "drive_nodes", "start"))
    start = tmp_path / "prefix" / "lib" / "drive_nodes" / "start"
    start.write_text(f'#!/bin/sh\nexec {sys.executable} node.py "$@"\n', encoding="utf-8")
    (tmp_path / "node.py").write_text(PROGRAM, encoding="utf-8")
    text = TEXT.replace('driver" gate preload', f'driver" gate {gate}')
    (tmp_path / "drive.stride").write_text(text, encoding="utf-8")
    (tmp_path / "system").mkdir()
    workspace = Workspace(tmp_path / "system")
    manager = Manager(load(tmp_path / "drive.stride").require(), backends.make("ros2", workspace), workspace, tmp_path)
    heard: list[str] = []

    async def scenario() -> None:
        from std_msgs.msg import String

        await manager.up()
        lidar = manager.specification.nodes["lidar"]
        with Bare("recorder") as bare:
            bare.node.create_subscription(String, "/cmd", lambda message: heard.append(message.data), 1000)

            async def hears(words: str) -> None:
                await bare.until(lambda: heard[-5:] == [words] * 5, 60)

            async def changed(request: PlanRequest) -> tuple[str, str | None]:
                change = asyncio.ensure_future(manager.change(request))
                await bare.until(change.done, 60)
                return change.result().outcome, change.result().because

            await hears("1.0 2")
            (tmp_path / "refuse").touch()
            outcome, because = await changed(PlanRequest(remove=("lidar",)))
            assert outcome == "rolled_back"
            assert "driver refuses gain = 5, speed = 0.25: the driver is locked" in str(because)
            assert (await manager.status()).valid
            (tmp_path / "refuse").unlink()
            assert await changed(PlanRequest(remove=("lidar",))) == ("done", None)
            await hears("0.25 5")
            assert await changed(PlanRequest(add=(lidar,))) == ("done", None)
            await hears("1.0 2")
        assert {*heard} == {"1.0 2", "0.25 5"}
        await manager.down()
        await manager.close()

    with ended():
        run(scenario())
