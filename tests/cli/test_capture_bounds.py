"""`midstride capture` proposes the bound of a plain rclpy server by what its clients wait for, and it is kept."""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

# Each request takes 50 ms.
SERVER = """
import time
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

def answer(request, response):
    time.sleep(0.05)
    return response

rclpy.init()
node = Node("maps")
served = [node.create_service(Trigger, name, answer) for name in ("map", "unused")]
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
CALLER = """
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

rclpy.init()
node = Node("caller")
client = node.create_client(Trigger, "map")
timer = node.create_timer(0.1, lambda: client.call_async(Trigger.Request()) if client.service_is_ready() else None)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


def test_the_bound_of_a_server_is_proposed_by_how_long_its_clients_wait(midstride: Midstride, tmp_path: Path) -> None:
    file = tmp_path / "called.stride"
    text = "system called\n"
    for name, program in (("maps", SERVER), ("caller", CALLER)):
        (tmp_path / f"{name}.py").write_text(program, encoding="utf-8")
        run = f"{sys.executable} {tmp_path / name}.py"
        text += f'component {name.title()} {{ run "{run}" gate preload }}\nnode {name} : {name.title()}\n'
    file.write_text(text, encoding="utf-8")
    assert midstride("up", str(file), "-d", "--backend", "ros2", timeout=120).status == 0
    try:
        found = midstride("capture", "--into", str(file), "--rates", "--seconds", "4", timeout=120)
    finally:
        assert midstride("down", timeout=60).status == 0
    captured = file.read_text(encoding="utf-8")
    print(found.err, captured)
    assert found.status == 0, found.err
    seen = re.search(r"answered (\d+) requests: median ([\d.]+) ms, longest .*; proposed: within ", captured)
    assert seen is not None and int(seen[1]) > 10 and float(seen[2]) >= 50
    maps = load(file).require().components["Maps"]
    (bound,) = (maps.stated_bound(port, {each.name: each.modes[0].name for each in maps}) for port in maps.outputs)
    assert bound is not None and 0.1 <= bound < 5.0
    assert "no port for service /unused: no other node here calls it" in captured

    # It runs with what was captured, and the bound is measured and kept.
    assert midstride("up", str(file), "-d", "--backend", "ros2", timeout=120).status == 0
    try:
        for look in range(20):
            status = json.loads(midstride("status", "--json").out)
            assert look < 10 or (status["valid"] and not status["silences"]), status
            time.sleep(0.5)
    finally:
        assert midstride("down", timeout=60).status == 0
