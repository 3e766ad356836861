"""Bounds of a server with the API, on real processes: what relies on it degrades, and a late one goes back."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.lang.load import load_text
from midstride.model.component import FunctionalityRef
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import declared_talker, robot
from tests.acceptance.serving import SERVER as TALKER
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

# Takes as long as a request says (ms); started with `late`, half a second for each.
SERVER = """
import sys
import time

from midstride import Component
from rcl_interfaces.srv import ListParameters

comp = Component("Maps")

def answer(request, response):
    time.sleep(0.5 if "late" in sys.argv else request.depth / 1000)

map = comp.create_server("map", ListParameters, answer, within=0.2)
serve = comp.create_functionality("serve", outputs=[map])
serve.set_normal_mode(lambda: None, outputs=[map])
serve.set_degraded_mode(lambda: None, name="off")
comp.start()
"""
# Plain rclpy, and relies on the server without ever calling it.
USER = """
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters

rclpy.init()
node = Node("user")
client = node.create_client(ListParameters, "map")
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
TEXT = f"""system bounds
topic /chat : std_msgs/msg/String @ 50 Hz
{declared_talker("Talker", "python3 talker.py", "preload")}
timing {{ watch_after 4 s }}
contract Listing = rcl_interfaces/srv/ListParameters responds within 0.2 s
service /map : Listing
component Maps {{
  run "python3 server.py"
  server map
  functionality serve {{ produces map  mode normal {{ guarantee map : Listing }}  mode off {{ }} }}
}}
component Late like Maps {{ run "python3 server.py late" }}
component User {{
  run "python3 user.py" gate preload
  client map : Listing tolerates 5 missed
  functionality mapping {{ uses map  mode normal {{ assume map }}  mode off {{ }} }}
}}
node talker : Talker {{ out -> /chat }}
node maps : Maps {{ map -> /map }}
node user : User {{ map <- /map }}
"""


def test_the_bound_of_a_server_with_the_api_is_measured(tmp_path: Path) -> None:
    (tmp_path / "server.py").write_text(SERVER)
    (tmp_path / "user.py").write_text(USER)
    (tmp_path / "talker.py").write_text(TALKER)

    async def scenario() -> None:
        from rcl_interfaces.srv import ListParameters

        async with robot(load_text(TEXT).require(), tmp_path) as system:
            manager = system.manager
            client = system.bare.node.create_client(ListParameters, "/map")
            await system.until(client.service_is_ready)

            def mode() -> str:
                return manager.configuration.mode(FunctionalityRef("user", "mapping")).name

            # It hangs: what relies on it degrades after 1.2 s, and after 5 s it is a fault by its own promise.
            assert mode() == "normal"
            hanging = client.call_async(ListParameters.Request(depth=9000))
            await system.until(lambda: mode() == "off")
            assert not hanging.done()
            (user,) = (each for each in (await manager.status()).instances if each.role == "user")
            because = user.functionalities[0].because or ""
            assert because.startswith(
                "the assumption of mode normal broke: client map: the server of /map has not answer"
            )
            while not (faults := [each.words for each in (await manager.status()).silences]):
                assert not hanging.done()
                await system.bare.spin()
            assert faults == ["maps.map has not answered a request on /map, although 0.2 s are promised"]
            await system.until(hanging.done)
            await system.until(lambda: mode() == "normal")
            while (await manager.status()).silences:
                await system.bare.spin()

            # A replacement that is late is taken back.
            late = system.bare.node.create_timer(0.1, lambda: client.call_async(ListParameters.Request()))
            outcome = await system.meanwhile(manager.change(PlanRequest(replace=(("maps", "Late"),))))
            late.cancel()
            assert outcome.outcome == "rolled_back"
            assert "requests late (in up to" in (outcome.because or "") or "has not answered for" in (
                outcome.because or ""
            )
            assert "on /map after the hand-over: 0.2 s are promised" in (outcome.because or "")
            await system.until(lambda: mode() == "normal")

    with ended():
        run(scenario(), 120)
