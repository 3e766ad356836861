"""Three nodes in plain rclpy: their parameters are set by ROS's own service and by Midstride, and kept or set back.

One of them is behind a relay, and the others have the library preloaded.
"""

from __future__ import annotations

import asyncio
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from immutables import Map
from msgspec import UNSET

from midstride import backends
from midstride.errors import CommandRefused
from midstride.lang.load import load, load_text
from midstride.model.component import ParameterValue
from midstride.plan.request import PlanRequest
from midstride.plan.runtime_values import time_of
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from midstride.verdicts.assessment import seconds_in_words
from tests.acceptance.support import ended
from tests.acceptance.test_parameters import set_by_a_client
from tests.backends.ros2_support import Bare, run, until_async

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# It refuses a speed above 5, and writes every fourth of its messages where it is above 3.
PROGRAM = """
import itertools
import rclpy
from pathlib import Path
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String

rclpy.init()
node = Node("driver")
node.declare_parameter("speed", 9.0)
node.declare_parameter("gain", 0.1)
node.declare_parameter("weights", [0.5, 0.25])
node.declare_parameter("later", Parameter.Type.STRING)  # it has no value yet
node.declare_parameter("frame", "base", ParameterDescriptor(read_only=True))
node.declare_parameter("offset", 0.0)
out = node.create_publisher(String, "cmd", 10)
count = itertools.count()

def check(parameters):
    fast = any(each.name == "speed" and each.value > 5 for each in parameters)
    return SetParametersResult(successful=not fast, reason="it is too fast" if fast else "")

def drive():
    speed = node.get_parameter("speed").value
    if speed <= 3 or next(count) % 4 == 0:  # at 20 Hz or at 5: a busy machine delays some
        out.publish(String(data=str(speed)))

node.add_on_set_parameters_callback(check)
node.create_timer(0.05, drive)

def calibrate():  # once it is known what it started with, it sets a parameter itself
    if Path("calibrate").exists() and node.get_parameter("offset").value == 0.0:
        node.set_parameters([Parameter("offset", value=0.5)])

node.create_timer(0.2, calibrate)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
TEXT = """system drive

topic /left  : std_msgs/msg/String @ 10 Hz
topic /right : std_msgs/msg/String @ 10 Hz
topic /third : std_msgs/msg/String @ 10 Hz

component Driver {
  run "PYTHON node.py" gate preload
  parameters { changeable speed = 1.0 }
  output cmd
  functionality drive {
    produces cmd
    mode normal { guarantee cmd : std_msgs/msg/String @ 10 Hz }
    mode degraded { }
  }
}

component Relayed like Driver { run "PYTHON node.py" gate relay }

node left  : Driver  { cmd -> /left }
node third : Driver  { cmd -> /third }
node right : Relayed { cmd -> /right   parameters { speed = 2.0 } }

timing { watch_after 2 s }
"""
# For how long values are watched, as stated; then the three nodes are asked in turn, each for as long as it takes (s).
WATCHED = 2
# The library notes what requests set; of a program behind a relay nothing does.
KEPT = {
    ("left", "gain", "kept", "set"),
    ("left", "offset", "kept", "node"),
    ("left", "speed", "kept", "set"),
    ("left", "weights", "kept", "set"),
    ("right", "gain", "kept", "unknown"),
    ("right", "offset", "kept", "unknown"),
    ("right", "speed", "kept", "set"),
    ("third", "offset", "kept", "node"),
}


def test_parameters_of_plain_nodes_are_set_kept_and_set_back(tmp_path: Path) -> None:
    (tmp_path / "node.py").write_text(PROGRAM, encoding="utf-8")
    text = TEXT.replace("PYTHON", sys.executable)
    (tmp_path / "drive.stride").write_text(text, encoding="utf-8")
    (tmp_path / "system").mkdir()
    workspace = Workspace(tmp_path / "system")
    manager = Manager(load(tmp_path / "drive.stride").require(), backends.make("ros2", workspace), workspace, tmp_path)

    async def scenario() -> None:
        await manager.up()
        try:
            await set_and_kept()
        finally:
            await manager.down()
            await manager.close()

    async def set_and_kept() -> None:
        with Bare("tool") as bare:

            async def carried_out(request: PlanRequest) -> Outcome:
                change = asyncio.ensure_future(manager.change(request))
                await bare.until(change.done, 120)
                return change.result()

            async def values(role: str) -> dict[str, object]:
                (report,) = await manager.parameters(role)
                return {each.name: each.value for each in report.parameters if each.name in ("speed", "gain", "frame")}

            # Asked for its parameters once, it is known what it started with.
            assert await values("left") == {"speed": 1.0, "gain": 0.1, "frame": "base"}
            begun = time.time()
            assert await set_by_a_client(bare, "/left", "gain", 0.25) == (True, "")
            (report,) = await manager.parameters("left")
            (gain_now,) = (each for each in report.parameters if each.name == "gain")
            assert (gain_now.value, gain_now.origin) == (0.25, UNSET)
            set_at = gain_now.set_at
            assert isinstance(set_at, float) and begun < set_at < time.time()
            # What a node sets itself is told from that.
            (tmp_path / "calibrate").touch()

            async def sets_its_own(role: str, origin: str) -> bool:
                (report,) = await manager.parameters(role)
                return (0.5, origin) in [(each.value, each.origin) for each in report.parameters]

            for role, origin in (("third", "node"), ("left", "node"), ("right", "unknown")):
                await until_async(partial(sets_its_own, role, origin))
            await manager.set_parameters("left", {"speed": 2, "weights": []})
            with pytest.raises(CommandRefused, match=r"left refuses speed = 6\.0: it is too fast"):
                await manager.set_parameters("left", {"speed": 6.0})
            with pytest.raises(CommandRefused, match=r"it has no sped; did you mean `speed`\?"):
                await manager.set_parameters("left", {"sped": 6.0})
            with pytest.raises(CommandRefused, match=r"left refuses frame = 'odom': .*read-only"):
                await manager.set_parameters("left", {"frame": "odom"})

            # Behind a relay as well.
            assert await values("right") == {"speed": 2.0, "gain": 0.1, "frame": "base"}
            assert await set_by_a_client(bare, "/right", "gain", 0.75) == (True, "")
            with pytest.raises(CommandRefused, match=r"right refuses frame = 'odom': .*read-only"):
                await manager.set_parameters("right", {"frame": "odom"})

            # One of three nodes refuses, and then one breaks its rate.
            had = ((2.0, 0.25), (2.0, 0.75), (1.0, 0.1))
            before = [{"speed": speed, "gain": gain, "frame": "base"} for speed, gain in had]
            for speed, because, fate in (
                (6.0, "right refuses speed = 6.0: it is too fast", "not_set"),
                (4.0, "right.cmd does not keep the 10 Hz that its mode guarantees", "set_back"),
            ):
                request = setting(left={"gain": 0.5, "speed": 3}, third={"speed": 3}, right={"speed": speed})
                outcome = await carried_out(request)
                assert outcome.outcome == "rolled_back" and because in str(outcome.because), outcome.because
                assert [await values(role) for role in ("left", "right", "third")] == before
                found = {(each.node, each.parameter): each for each in outcome.parameters}
                back = [("left", "gain"), ("left", "speed"), ("third", "speed")]
                assert {key: each.fate for key, each in found.items()} == {
                    **dict.fromkeys(back, "set_back"),
                    ("right", "speed"): fate,
                }
                for key in back:  # for how long it had the value
                    assert 0 < float(found[key].seconds or 0) < min(outcome.seconds, WATCHED + 5)
                    assert seconds_in_words(float(found[key].seconds or 0)) in found[key].words
            outcome = await carried_out(setting(left={"speed": 3}, right={"speed": 3}))
            assert (outcome.outcome, outcome.because) == ("done", None)

            # What was set travels, also what a tool has set.
            outcome = await carried_out(PlanRequest(restart=("left", "right", "third")))
            assert (outcome.outcome, outcome.because) == ("done", None)
            assert {(each.node, each.parameter, each.fate, each.origin) for each in outcome.parameters} == KEPT
            (gain,) = (each for each in outcome.parameters if (each.node, each.parameter) == ("left", "gain"))
            assert gain.set_at == set_at
            assert gain.words == (
                f"left: gain = 0.25, set at run time: kept (a request has set it at {time_of(set_at)})"
            )
            assert await values("left") == {"speed": 3.0, "gain": 0.25, "frame": "base"}
            assert await values("right") == {"speed": 3.0, "gain": 0.75, "frame": "base"}
            (report,) = await manager.parameters("left")
            assert [each.value for each in report.parameters if each.name == "weights"] == [[]]

            # `apply` sets in place what is changeable.
            target = load_text(
                text.replace("speed = 2.0", "speed = 2.5").replace("speed = 1.0", "speed = 1.5")
            ).require()
            outcome = await carried_out(PlanRequest(to=target))
            assert (outcome.outcome, outcome.because) == ("done", None)
            assert [(await values(role))["speed"] for role in ("left", "right")] == [1.5, 2.5]
            assert {*manager.configuration.instances} == {"left_2", "right_2", "third_2"}

    with ended():
        run(scenario())


def setting(**values: dict[str, ParameterValue]) -> PlanRequest:
    return PlanRequest(parameters=tuple((role, Map(each)) for role, each in values.items()))
