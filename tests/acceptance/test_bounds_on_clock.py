"""Bounds of a plain server on `/clock`, on real processes: a slow clock gives it time, one in real time takes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.lang.load import load_text
from midstride.model.component import FunctionalityRef
from midstride.runtime.options import SystemOptions
from midstride.wire.state import MeasuredResponses
from tests.acceptance.foreign_support import OURS
from tests.acceptance.support import ClockSource, ended, managed
from tests.acceptance.test_measured_bounds import USER
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

# Takes as long as a request says (ms, of real time).
SERVER = """
import time
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters

def answer(request, response):
    time.sleep(request.depth / 1000)
    return response

rclpy.init()
node = Node("maps")
served = node.create_service(ListParameters, "map", answer)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
TEXT = """system bounds
contract Listing = rcl_interfaces/srv/ListParameters responds within 0.2 s
topic /chat : std_msgs/msg/String @ 50 Hz
service /map : Listing
component Talker {
  run "python3 talker.py"
  output out
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }  mode degraded { } }
}
component Maps {
  run "python3 server.py" gate preload
  server map
  functionality serve { produces map  mode normal { guarantee map : Listing }  mode off { } }
}
component User {
  run "python3 user.py" gate preload
  client map : Listing tolerates 3 missed
  functionality mapping { uses map  mode normal { assume map }  mode off { } }
}
node talker : Talker { out -> /chat }
node maps : Maps { map -> /map }
node user : User { map <- /map }
"""
# How long each request takes (s), and the seconds on `/clock` in each second at which that is in time.
TAKES, SLOW = 0.5, 0.25


def test_a_bound_is_one_of_the_time_on_the_clock(tmp_path: Path) -> None:
    for name, program in (("talker", OURS.replace('"Ours"', '"Talker"')), ("server", SERVER), ("user", USER)):
        (tmp_path / f"{name}.py").write_text(program, encoding="utf-8")

    async def scenario() -> None:
        from rcl_interfaces.srv import ListParameters

        options = SystemOptions(use_sim_time=True)
        async with managed(tmp_path / "system", load_text(TEXT).require(), tmp_path, options) as (manager, _):
            with Bare() as bare:
                client = bare.node.create_client(ListParameters, "/map")
                await bare.until(client.service_is_ready)

                def mode() -> str:
                    return manager.configuration.mode(FunctionalityRef("user", "mapping")).name

                async def answered() -> MeasuredResponses | None:
                    """What is seen of the server once it has answered once more."""
                    done = client.call_async(ListParameters.Request(depth=int(TAKES * 1000)))
                    await bare.until(done.done)
                    found = (await manager.peek("maps")).ports["map"]["/map"].responses
                    if found is not None and found.longest is not None:  # of those since the look before
                        took.append(found.longest)
                    return found

                took: list[float] = []
                while len(took) < 5 or (found := await answered()) is None:
                    found = await answered()
                assert found.late == 0 and found.broken is None and mode() == "normal", found
                assert SLOW * TAKES * 0.9 <= max(took) <= 0.2

                clock.drive(1.0)
                took.clear()
                while mode() == "normal":
                    await answered()
                assert max(took) >= TAKES * 0.9
                because = {row.role: row.functionalities for row in (await manager.status()).instances}["user"][
                    0
                ].because
                assert "the server of /map has answered late" in (because or "")

                clock.drive(SLOW)
                while mode() != "normal":
                    await answered()

    with ended():
        clock = ClockSource(tmp_path, SLOW)
        try:
            run(scenario(), 180)
        finally:
            clock.stop()
