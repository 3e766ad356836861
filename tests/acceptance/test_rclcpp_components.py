"""Composable nodes on rclcpp in a container of rclcpp_components, where a ROS 2 that has both is sourced.

There are no wheels of these: elsewhere it is skipped, and test_shared_containers.py does the same with a stand-in.
"""

from __future__ import annotations

import os
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import Robot, holes, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run
from tests.on_rclcpp import OnRclcpp

pytestmark = [pytest.mark.ros2, pytest.mark.long]

ROBOT = """system composed
topic /front/chat  : std_msgs/msg/String @ 45 Hz
topic /front/heard : std_msgs/msg/String @ 40 Hz
component Talker {
  run component "demo::Talker" package "demo" gate preload
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 45 Hz }
    mode degraded { }
  }
}
component Later like Talker { run component "demo::Talker" package "demo" gate preload }
component Listener {
  run component "demo::Listener" package "demo" gate preload
  input in : std_msgs/msg/String @ 40 Hz as chatter
  output out as heard
  functionality listen {
    uses in
    produces out
    mode normal { assume in  guarantee out : std_msgs/msg/String @ 40 Hz }
    mode degraded { }
  }
}
namespace front {
  container pipeline { run "component_container" }
  node talker   : Talker in pipeline   { out -> chat }
  node listener : Listener in pipeline { in <- chat  out -> heard }
}
"""


@pytest.fixture
def on_rclcpp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> OnRclcpp:
    made = OnRclcpp(tmp_path / "prefix")
    made.install("old")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{made.prefix}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    return made


def writers(heard: list[tuple[float, str, int]]) -> list[str]:
    return [name for name, _ in groupby(heard, lambda each: each[1])]


async def pids(made: Robot) -> dict[str, int | None]:
    return {each.role: each.pid for each in (await made.manager.status()).instances}


def test_a_component_of_rclcpp_leaves_its_container_which_goes_on_and_all_move_together(
    on_rclcpp: OnRclcpp, tmp_path: Path
) -> None:
    """The listener passes on what it hears of the talker: what goes past the gate within the process shows there."""
    path = tmp_path / "composed.stride"
    path.write_text(ROBOT, encoding="utf-8")

    async def main() -> None:
        async with robot(load(path).require(), tmp_path, topic="/front/chat") as made:
            from std_msgs.msg import String

            passed: list[tuple[float, str, int]] = []

            def passes(message: Any) -> None:
                name, number = message.data.split()
                passed.append((0.0, name, int(number)))

            made.bare.node.create_subscription(String, "/front/heard", passes, 1000)
            before = await pids(made)
            assert before["front/talker"] == before["front/listener"]

            on_rclcpp.install("new")
            done = await made.change("Later", role="front/talker")
            assert (done.outcome, done.because) == ("done", None)
            await made.until(lambda: made.heard[-1][1] == "front/talker_2-new")
            after = await pids(made)
            assert after["front/listener"] == before["front/listener"] != after["front/talker"]

            moved = await made.meanwhile(made.manager.change(PlanRequest(restart=("front/pipeline",))))
            assert (moved.outcome, moved.because) == ("done", None)
            await made.hears(20)
            together = await pids(made)
            assert together["front/talker"] == together["front/listener"] != before["front/listener"]
            await made.until(lambda: passed[-1][1] == made.heard[-1][1] == "front/pipeline_2-new")

            expected = ["front/pipeline-old", "front/talker_2-new", "front/pipeline_2-new"]
            assert writers(made.heard) == writers(passed) == expected
            assert made.holes() == holes(passed) == []

    with ended():
        run(main())
