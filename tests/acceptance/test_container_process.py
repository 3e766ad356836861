"""The process of a shared container, on real ROS 2: how it is started, seen, and joined by a replacement.

The container is a stand-in for that of rclcpp_components, in C.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from midstride.backends import ros2
from midstride.capture.observed_processes import ObservedProcess, observed_processes
from midstride.lang.load import load
from midstride.model.component import FunctionalityRef
from midstride.plan.request import PlanRequest
from midstride.runtime.process.reaper import environment_value
from tests.acceptance.foreign_support import holes, robot
from tests.acceptance.support import ended
from tests.acceptance.test_shared_containers import Neighbour, pids
from tests.backends.ros2_support import run
from tests.composition import StandIn

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

ROBOT = """system joined
topic /front/chat  : std_msgs/msg/String @ 45 Hz
topic /front/other : std_msgs/msg/String @ 45 Hz
component Talker {
  run component "demo::Talker" package "demo" gate preload
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 45 Hz }
    mode degraded { }
  }
}
component Later like Talker { parameters { first = 5000 } }
namespace front {
  container pipeline {
    run "component_container" prefix "nice -n 1" takes 5 s stop sigterm 3 s
    environment { JOINED = "yes"   unset LEFT_OUT }
  }
  node talker : Talker in pipeline { out -> chat }
  node other : Talker in pipeline { out -> other }
}
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    monkeypatch.setenv("LEFT_OUT", "x")
    return StandIn.in_use(tmp_path, monkeypatch)


def test_a_replacement_joins_the_process_that_is_started_as_stated(stand_in: StandIn, tmp_path: Path) -> None:
    path = tmp_path / "joined.stride"
    path.write_text(ROBOT, encoding="utf-8")
    specification = load(path).require()

    async def main() -> None:
        async with robot(specification, tmp_path, topic="/front/chat") as made:
            neighbour = Neighbour(made)
            before = await pids(made)
            process = before["front/talker"]
            assert process is not None
            assert [environment_value(process, name) for name in ("JOINED", "LEFT_OUT")] == ["yes", None]
            assert os.getpriority(os.PRIO_PROCESS, process) == os.getpriority(os.PRIO_PROCESS, 0) + 1
            seen = await asyncio.to_thread(ros2.observe, 2.0)
            # No topic shows which process the node of the stand-in container is in, which has services alone.
            assert ObservedProcess(("/front/other", "/front/talker")) in observed_processes(seen)
            assert seen.containers == {"/front/pipeline"}

            request = PlanRequest(replace=(("front/talker", "Later"),), same_process=True)
            plan = await made.manager.plan(request)
            assert any("starts in front/pipeline, beside front/talker" in each for each in plan.remarks), plan.remarks
            joined = await made.meanwhile(made.manager.change(request))
            assert (joined.outcome, joined.because) == ("done", None)
            await made.hears(20)
            assert set((await pids(made)).values()) == {process}
            assert made.heard[-1][2] > 5000
            (cut,) = holes(made.heard)  # both have the name of their process, and the new one counts from 5000 on
            assert cut.last < 5000 <= cut.next
            assert holes(neighbour.heard) == []
            made.heard.clear()
            status = (await made.manager.status()).instances
            assert {each.name: each.node for each in status} == {
                "front/talker_2": "/front/talker_2",
                "front/other": "/front/other",
            }

            moving = PlanRequest(restart=("front/pipeline",))
            plan = await made.manager.plan(moving)
            assert any("front/pipeline_2, beside its predecessor, needs about" in each for each in plan.remarks)
            moved = await made.meanwhile(made.manager.change(moving))
            assert (moved.outcome, moved.because) == ("done", None)
            await made.hears(20)
            (new,) = set((await pids(made)).values())
            assert new not in (process, None)
            assert holes(made.heard) == holes(neighbour.heard) == []
            configuration = made.manager.configuration
            assert configuration.mode(FunctionalityRef("front/talker_3", "talk")).name == "normal"

    with ended():
        run(main())
