"""A foreign ROS node with every service and every topic of the graph at hand changes nothing of a running system."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from midstride.runtime.manager import Manager
from tests.acceptance.support import managed, swap_specification
from tests.backends.ros2_support import run

pytestmark = pytest.mark.ros2

# It calls each service of the graph, with the parameters that its node lists where it takes some, and publishes on each
# topic. What it did is its output.
INTRUDER = """
import importlib, json, sys, time
import rclpy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import ListParameters

def load(kind):
    package, folder, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), name)

def call(node, kind, name, request):
    client = node.create_client(kind, name)
    assert client.wait_for_service(10.0), name
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    assert future.done(), name
    node.destroy_client(client)
    return future.result()

rclpy.init()
node = rclpy.create_node("intruder")
expected = {"/" + name for name in sys.argv[1:]}
deadline = time.monotonic() + 20
while not expected <= {name.rpartition("/")[0] for name, _ in node.get_service_names_and_types()}:
    assert time.monotonic() < deadline
    rclpy.spin_once(node, timeout_sec=0.05)
called, set_, published = [], [], []
for name, kinds in node.get_service_names_and_types():
    owner = name.rpartition("/")[0]
    if owner == "/intruder":
        continue
    kind = load(kinds[0])
    request = kind.Request()
    if kinds[0].startswith("rcl_interfaces/srv/SetParameters"):
        listed = call(node, ListParameters, owner + "/list_parameters", ListParameters.Request()).result.names
        for parameter in listed:
            text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="degraded")
            for value in (text, ParameterValue()):
                request = kind.Request(parameters=[Parameter(name=parameter, value=value)])
                answer = call(node, kind, name, request)
                results = getattr(answer, "results", None) or [answer.result]
                set_.append([owner, parameter, any(result.successful for result in results)])
    else:
        call(node, kind, name, request)
    called.append(name)
for name, kinds in node.get_topic_names_and_types():
    if name == "/swap":
        continue  # messages of the system itself: whoever publishes there is a publisher
    publisher = node.create_publisher(load(kinds[0]), name, 10)
    for _ in range(5):
        publisher.publish(load(kinds[0])())
        rclpy.spin_once(node, timeout_sec=0.02)
    published.append(name)
print(json.dumps([called, set_, published]))
"""


@pytest.mark.full
def test_nothing_that_comes_by_ros_changes_a_component(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            before = await snapshot(manager)
            script = tmp_path / "intruder.py"
            script.write_text(INTRUDER, encoding="utf-8")
            intruder = await asyncio.to_thread(
                subprocess.run,
                [sys.executable, str(script), *manager.configuration.instances],
                capture_output=True,
                text=True,
                timeout=90,
                check=False,
            )
            assert intruder.returncode == 0, intruder.stderr
            called, changed, published = json.loads(intruder.stdout.splitlines()[-1])
            assert called and published
            ours = [(node, name) for node, name, _ in changed if name.startswith("midstride.")]
            assert {node for node, _ in ours} == {f"/{name}" for name in manager.configuration.instances}
            assert [entry for entry in changed if entry[2] and entry[1].startswith("midstride.")] == []
            assert await snapshot(manager) == before
            assert (await manager.status()).valid

    run(scenario())


async def snapshot(manager: Manager) -> dict[str, Any]:
    """Modes, gates, endpoints and revision of each component, as it says itself."""
    found = {}
    for name in manager.configuration.instances:
        state = await manager.peek(name)
        modes = {each: (view.mode, view.because) for each, view in state.functionalities.items()}
        gates = {(port, topic): link.gate for port, links in state.ports.items() for topic, link in links.items()}
        found[name] = (state.revision, modes, gates)
    return found
