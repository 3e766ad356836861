"""Services that are declared, of plain rclpy nodes: replaced with and without a topic, and what relies on them."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest

from midstride.lang.load import load_text
from midstride.model.component import FunctionalityRef
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import robot
from tests.acceptance.serving import CLIENTS, SERVER, called
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Serves, and publishes nothing.
MAPS = """
import time
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters

rclpy.init()
node = Node("maps")


def map(request, response):
    time.sleep(request.depth / 1000)
    return response


node.create_service(ListParameters, "map", map)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
# Relies on both.
USER = """
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters

rclpy.init()
node = Node("user")
clients = [node.create_client(ListParameters, name) for name in ("count", "map")]
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
TEXT = """system serving
contract Listing = rcl_interfaces/srv/ListParameters responds within 0.5 s
topic /chat : std_msgs/msg/String @ 50 Hz
service /count : Listing
service /map : Listing
component Talker {
  run "python3 server.py" gate preload
  output out as chatter
  server count
  functionality talk {
    produces out, count
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz  guarantee count : Listing }
    mode degraded { }
  }
}
component Other like Talker { run "python3 server.py" gate preload }
component Maps {
  run "python3 maps.py" gate preload
  server map
  functionality serve { produces map  mode normal { guarantee map : Listing }  mode off { } }
}
component Astray like Maps { run "python3 user.py" gate preload }
component User {
  run "python3 user.py" gate preload
  client count : Listing
  client map : Listing tolerates 2 missed
  functionality counting { uses count  mode normal { assume count }  mode off { } }
  functionality mapping { uses map  mode normal { assume map }  mode off { } }
}
node talker : Talker { out -> /chat  count -> /count }
node maps : Maps { map -> /map }
node user : User { count <- /count  map <- /map }
"""


@pytest.mark.long
def test_a_new_server_of_another_type_is_not_accepted(tmp_path: Path) -> None:
    """While both run, both types are in the graph under one name."""
    text = TEXT + 'component Typed like Maps { run "python3 typed.py" gate preload }\n'
    typed = MAPS.replace("ListParameters", "GetParameters")
    for name, program in (("server", SERVER), ("maps", MAPS), ("user", USER), ("typed", typed)):
        (tmp_path / f"{name}.py").write_text(program)

    async def scenario() -> None:
        async with robot(load_text(text).require(), tmp_path) as system:
            refused = await system.meanwhile(system.manager.change(PlanRequest(replace=(("maps", "Typed"),))))
            assert refused.outcome == "rolled_back"
            assert (
                "serves service /map of type rcl_interfaces/srv/GetParameters, and server map of Typed is declared as "
                "rcl_interfaces/srv/ListParameters"
            ) in (refused.because or "")
            assert system.manager.configuration.mode(FunctionalityRef("user", "mapping")).name == "normal"

    run(scenario())


def test_declared_services_are_replaced_and_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in (("server", SERVER), ("clients", CLIENTS), ("maps", MAPS), ("user", USER)):
        (tmp_path / f"{name}.py").write_text(text)

    async def scenario() -> None:
        async with robot(load_text(TEXT).require(), tmp_path) as system:
            manager = system.manager
            mapping, counting = (FunctionalityRef("user", name) for name in ("mapping", "counting"))

            def mode(ref: FunctionalityRef) -> str:
                return manager.configuration.mode(ref).name

            assert (mode(mapping), mode(counting)) == ("normal", "normal")
            async with called(tmp_path, system, clients=5):  # which judges that each request is handled once
                await system.replaced("Other")
            assert system.holes() == []

            # Without a topic, requests alone are handed over.
            outcome = await system.meanwhile(manager.change(PlanRequest(restart=("maps",))))
            assert (outcome.outcome, outcome.because) == ("done", None)
            assert outcome.plan is not None
            assert "HandoverStep" in [type(step).__name__ for step in outcome.plan.steps]
            (maps,) = (each for each in (await manager.status()).instances if each.role == "maps")
            assert maps.answers and not maps.differences and maps.deviation is None
            assert mode(mapping) == "normal"

            # A program that does not serve what it should is not accepted, and the old one serves on.
            monkeypatch.setattr("midstride.foreign.gated_agent.GRAPH_TIMEOUT", 0.5)
            monkeypatch.setattr("midstride.foreign.graph_check.ENDPOINTS_TIMEOUT", 0.5)
            refused = await system.meanwhile(manager.change(PlanRequest(replace=(("maps", "Astray"),))))
            assert refused.outcome == "rolled_back"
            # A busy machine may not even show its node by then.
            why = "does not serve service /map, for server map of Astray|the graph shows no node /maps of its process"
            assert re.search(why, refused.because or ""), refused.because
            assert mode(mapping) == "normal"

            # What relies on a server that hangs degrades, and nothing else; it is back when that answers again.
            from rcl_interfaces.srv import ListParameters

            client = system.bare.node.create_client(ListParameters, "/map")
            await system.until(client.service_is_ready)
            hanging = client.call_async(ListParameters.Request(depth=4000))
            await system.until(lambda: mode(mapping) == "off")
            (user,) = (each for each in (await manager.status()).instances if each.role == "user")
            (found,) = (each for each in user.functionalities if each.name == "mapping")
            assert re.fullmatch(
                r"the assumption of mode normal broke: client map: the server of /map has not answered a request for "
                r"[\d.]+ s, 0\.5 s are promised \(silence is tolerated for 1\.5 s\)",
                found.because or "",
            )
            assert found.reflex and mode(counting) == "normal"
            await system.until(hanging.done)
            await system.until(lambda: mode(mapping) == "normal")

            # What relies on a server whose process has gone degrades, and nothing else.
            (maps,) = (each for each in (await manager.status()).instances if each.role == "maps")
            assert maps.pid is not None
            os.kill(maps.pid, signal.SIGKILL)
            await system.until(lambda: mode(mapping) == "off")
            assert mode(counting) == "normal"
            (status,) = (each for each in (await manager.status()).topics if each.name == "/map")
            assert not status.publishers

    with ended():
        run(scenario(), 120)
