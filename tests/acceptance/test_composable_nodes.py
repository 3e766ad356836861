"""Composable nodes on real ROS 2, each in a container of its own: a stand-in for that of rclcpp_components, in C."""

from __future__ import annotations

import os
import signal
from itertools import groupby
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.model.specification import Specification
from tests.acceptance.foreign_support import robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run
from tests.composition import TALKERS, StandIn

# Its types and its container are compiled first, which takes longer than the rest.
pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

ROBOT = f"""system composed
topic /front/chat : std_msgs/msg/String @ 45 Hz
{TALKERS}component Unknown like Talker {{ run component "demo::Tolker" package "demo" gate preload }}
namespace front {{
  node talker : Talker {{ out -> /front/chat }}
}}
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    return StandIn.in_use(tmp_path, monkeypatch)


def system(folder: Path) -> Specification:
    path = folder / "composed.stride"
    path.write_text(ROBOT, encoding="utf-8")
    return load(path).require()


def test_a_composable_node_is_replaced_with_new_code_and_what_cannot_be_loaded_is_said(
    stand_in: StandIn, tmp_path: Path
) -> None:
    async def main() -> None:
        async with robot(system(tmp_path), tmp_path, topic="/front/chat") as made:
            (before,) = (await made.manager.status()).instances
            assert (before.other_nodes, before.changed_files) == ([], [])
            stand_in.install("demo", text="new")
            (outdated,) = (await made.manager.status()).instances
            assert outdated.changed_files == [str(stand_in.prefix / "lib" / "libdemo.so")]

            done = await made.change("Later", role="front/talker")
            assert (done.outcome, done.because) == ("done", None)
            assert "talker_container" not in str(done), "the services of the container are nothing that others lose"
            await made.until(lambda: made.heard[-1][1] == "front/talker_2-new")
            assert made.heard[-1][2] > 5000, "the parameter of the request has not reached the node"
            await made.hears(20)
            assert [name for name, _ in groupby(made.heard, lambda each: each[1])] == [
                "front/talker-old",
                "front/talker_2-new",
            ]
            assert made.holes() == []

            for component, why in (
                (
                    "Failing",
                    "/front/talker_3_container has not loaded demo::Failing of package demo: Component constructor",
                ),
                ("Crashing", "signal 6"),
                ("Unknown", "package demo has no component class demo::Tolker; did you mean `demo::Talker`?"),
            ):
                refused = await made.change(component, role="front/talker")
                assert refused.outcome == "rolled_back", refused
                assert why in str(refused.because), refused.because
            await made.hears(20)
            assert made.heard[-1][1] == "front/talker_2-new"

            (running,) = (await made.manager.status()).instances
            assert running.pid is not None
            os.kill(running.pid, signal.SIGKILL)
            await made.until(lambda: not made.manager.configuration.instances)

    with ended():
        run(main())
