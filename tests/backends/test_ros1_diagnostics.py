"""``/diagnostics`` on real ROS 1, as a program that subscribes to it sees them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from midstride.wire.commands import SetParametersCommand
from tests.backends.ros1_support import program, rig
from tests.backends.ros2_support import run, until
from tests.backends.test_ros2_diagnostics import TALKER

pytestmark = pytest.mark.ros1

MONITOR = """
import json, sys, rospy
from diagnostic_msgs.msg import DiagnosticArray
rospy.init_node("monitor")
def write(array):
    for status in array.status:
        values = {each.key: each.value for each in status.values}
        print(json.dumps([status.name, status.level, status.message, status.hardware_id, values]), flush=True)
rospy.Subscriber("/diagnostics", DiagnosticArray, write)
rospy.spin()
"""


@pytest.mark.full
def test_a_slow_publisher_is_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("diagnostic_msgs")
    output = tmp_path / "monitor"

    def shows(level: int, words: str) -> bool:
        lines = [line for line in output.read_text().splitlines() if line.startswith("[")]
        statuses = [json.loads(line) for line in lines]
        return any(
            (name, found, instance) == ("talker: out on /talk", level, "talker_2") and words in message
            for name, found, message, instance, _ in statuses
        )

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            with program(source=MONITOR, output=output):
                _, registration = await r.start("talker_2", TALKER, node="talker")
                assert registration.endpoints == []
                await r.attach("talker_2", "out", "/talk")
                await r.modes("talker_2", talk="normal")
                await until(lambda: shows(0, "as declared"), 60.0)
                await r.client.change("talker_2", SetParametersCommand(parameters={"every": 5}))
                await until(lambda: shows(1, "10 Hz declared"), 60.0)
                assert await r.shows_no_writer("/diagnostics")

    run(scenario(), 240.0)
