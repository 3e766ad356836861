"""Two hand-overs side by side on real ROS 2: a bare recorder of both topics has every number exactly once."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from tests.acceptance.support import ended, managed
from tests.acceptance.test_state_at_the_cut import lines, recorded
from tests.runtime.side_by_side import all_replaced, three

pytestmark = [pytest.mark.ros2, pytest.mark.full]

TOPICS = ("first", "second")
PROBATION, WATCH = 3.0, 2.0
RECORDER = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("recorder")
heard = open(sys.argv[1], "a", buffering=1)
def note(topic):
    return lambda message: heard.write(topic + " " + message.data + chr(10))
for topic in ("first", "second"):
    node.create_subscription(String, "/" + topic, note(topic), 1000)
rclpy.spin(node)
"""


def assert_exactly_once(heard: list[str], topic: str) -> None:
    """Those of the old instance, then those of the new one, without a hole."""
    found = [line.split()[1:] for line in heard if line.startswith(f"{topic} ")]
    numbers = sorted(int(number) for number, _ in found)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert {instance for _, instance in found} == {topic, f"{topic}_2"}


def test_ros2_two_are_prepared_and_watched_at_once(tmp_path: Path) -> None:
    path = tmp_path / "heard"

    async def replaced(manager: Manager) -> tuple[Outcome, list[str]]:
        with recorded(RECORDER, path):
            await lines(path, 40)
            outcome = await manager.change(all_replaced(*TOPICS))
            return outcome, await lines(path, len(path.read_text().splitlines()) + 40)

    async def body() -> tuple[Outcome, list[str]]:
        specification = three(tmp_path, probation=PROBATION, watch_after=WATCH)
        async with managed(tmp_path / "system", specification, tmp_path) as (manager, _):
            return await replaced(manager)

    with ended():
        outcome, heard = asyncio.run(body())
    assert (outcome.outcome, outcome.because, outcome.own_state) == ("done", None, {})
    for topic in TOPICS:
        assert_exactly_once(heard[:-1], topic)  # the last line may be half a line
    assert outcome.plan is not None
    found = [time for time in outcome.steps if outcome.plan.steps[time.step - 1].action == "handover"]
    assert len(found) == 2 and all(time.seconds > PROBATION for time in found)
    first, second = sorted(found, key=lambda time: time.began)
    assert second.began < first.began + PROBATION, "the other one is prepared meanwhile"
