"""Several composable nodes in one container process, on real ROS 2: brought up, replaced one by one, crashed, moved.

The container is a stand-in for that of rclcpp_components, in C.
"""

from __future__ import annotations

import os
import signal
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from midstride.lang.load import load
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import Robot, holes, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run
from tests.composition import TALKERS, StandIn

# Its types and its container are compiled first, which takes longer than the rest.
pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

ROBOT = f"""system grouped
topic /front/chat  : std_msgs/msg/String @ 45 Hz
topic /front/other : std_msgs/msg/String @ 45 Hz
topic /front/made  : std_msgs/msg/String @ 45 Hz
{TALKERS}component Maker like Talker {{ run component "demo::Maker" package "demo" gate preload }}
namespace front {{
  container pipeline {{ run "component_container" }}
  node talker : Talker in pipeline {{
    out -> chat
    respawn
  }}
  node other : Talker in pipeline {{
    out -> other
    respawn
  }}
  node maker : Maker in pipeline {{
    out -> made
    respawn
  }}
}}
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    return StandIn.in_use(tmp_path, monkeypatch)


def system(folder: Path) -> Specification:
    path = folder / "grouped.stride"
    path.write_text(ROBOT, encoding="utf-8")
    return load(path).require()


class Neighbour:
    """What is heard of the node beside the one that is replaced."""

    def __init__(self, made: Robot) -> None:
        from std_msgs.msg import String

        self.heard: list[tuple[float, str, int]] = []
        made.bare.node.create_subscription(String, "/front/other", self._hear, 1000)

    def _hear(self, message: Any) -> None:
        name, number = message.data.split()
        self.heard.append((0.0, name, int(number)))


def writers(heard: list[tuple[float, str, int]]) -> list[str]:
    return [name for name, _ in groupby(heard, lambda each: each[1])]


async def pids(made: Robot) -> dict[str, int | None]:
    return {each.role: each.pid for each in (await made.manager.status()).instances}


def test_nodes_that_share_a_container_are_replaced_alone_and_moved_together(stand_in: StandIn, tmp_path: Path) -> None:
    async def main() -> None:
        async with robot(system(tmp_path), tmp_path, topic="/front/chat") as made:
            neighbour = Neighbour(made)
            before = await pids(made)
            assert before["front/talker"] == before["front/other"]
            maker, *rest = (await made.manager.status()).instances
            assert [each.name for each in maker.other_nodes] == ["/made/inner"], "the node that it has made is its own"
            assert [each.other_nodes for each in rest] == [[], []]
            one = rest[0]
            assert (one.container, one.process) == ("front/pipeline", "front/pipeline")
            stand_in.install("demo", text="new")

            for component, why in (("Failing", "no device"), ("Crashing", "signal 6")):
                refused = await made.change(component, role="front/talker")
                assert refused.outcome == "rolled_back", refused
                assert why in str(refused.because), refused.because
            assert await pids(made) == before

            done = await made.change("Later", role="front/talker")
            assert (done.outcome, done.because) == ("done", None)
            await made.hears(20)
            after = await pids(made)
            assert after["front/other"] == before["front/other"] != after["front/talker"]
            assert writers(made.heard) == ["front/pipeline-old", "front/talker_2-new"], writers(made.heard)
            assert made.heard[-1][2] > 5000
            assert holes(made.heard) == []
            assert writers(neighbour.heard) == ["front/pipeline-old"]
            assert holes(neighbour.heard) == []

            moved = await made.meanwhile(
                made.manager.change(PlanRequest(restart=("front/pipeline",), with_other_nodes=True))
            )
            assert (moved.outcome, moved.because) == ("done", None)
            await made.hears(20)
            together = await pids(made)
            assert together["front/talker"] == together["front/other"] not in (before["front/other"], None)
            assert holes(made.heard) == holes(neighbour.heard) == []
            assert writers(neighbour.heard) == ["front/pipeline-old", "front/pipeline_2-new"]

            await made.another_manager()
            assert await pids(made) == together
            crashed = together["front/other"]
            assert crashed is not None
            os.kill(crashed, signal.SIGKILL)

            def again() -> bool:
                return len(made.manager.configuration.instances) == 3

            await made.until(lambda: not again())
            await made.until(again)
            restored = await pids(made)
            assert restored["front/talker"] == restored["front/other"] != crashed

    with ended():
        run(main())
