"""What a launch file starts, imported and run on real ROS 2: each process has what launch would give it."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(200)]

# Writes what it was started with, and waits.
PROGRAM = f"""#!{sys.executable}
import json, os, sys
import rclpy

rclpy.init()
node = rclpy.create_node("own_name", automatically_declare_parameters_from_overrides=True)
parameters = {{name: each.value for name, each in node.get_parameters_by_prefix("").items()}}
print("FOUND", json.dumps({{
    "words": sys.argv[1:sys.argv.index("--ros-args")],
    "variable": os.environ.get("MODE"),
    "unset": "GONE" in os.environ,
    "niceness": os.getpriority(os.PRIO_PROCESS, 0),
    "parent": open(f"/proc/{{os.getppid()}}/cmdline").read(),
    "name": node.get_fully_qualified_name(),
    "topic": node.resolve_topic_name("out"),
    "rate": parameters.get("rate"),
    "list": parameters.get("list"),
    "text": len(parameters.get("text", "")),
}}), flush=True)
try:
    rclpy.spin(node)
except BaseException:
    pass
"""
LAUNCH = """<launch>
  <let name="words" value="two words"/><let name="none" value=""/>
  <let name="one" value="a, b"/><let name="other" value="c"/>
  <unset_env name="GONE"/>
  <node pkg="demo" exec="program" name="first" namespace="robot" args="--label $(var words) $(var none)">
    <remap from="out" to="/there"/>
    <param from="$(dirname)/rate.yaml"/>
    <param name="rate" value="40.0"/>
    <param name="list" value="[$(var one), $(var other)]"/>
    <param name="text" value="TEXT"/>
  </node>
  <executable cmd="ros2 run demo program --x --ros-args -r __node:=second"/>
  <node pkg="demo" exec="program" name="third" launch-prefix="nice -n 3">
    <env name="MODE" value="a b"/>
    <param from="$(dirname)/rate.yaml"/>
  </node>
</launch>
"""


def found(midstride: Midstride, name: str) -> dict[str, Any]:
    """What the program says that it was started with."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        lines = [line for line in midstride("logs", name).out.splitlines() if "FOUND" in line]
        if lines:
            return dict(json.loads(lines[0].partition("FOUND")[2]))
        time.sleep(0.2)
    raise AssertionError(f"{name} has written nothing")


def test_an_imported_launch_file_starts_what_launch_starts(midstride: Midstride, tmp_path: Path) -> None:
    prefix = tmp_path / "ws"
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    program = prefix / "lib" / "demo" / "program"
    program.parent.mkdir(parents=True)
    program.write_text(PROGRAM)
    program.chmod(0o755)
    (tmp_path / "rate.yaml").write_text(
        "first:\n  ros__parameters: {rate: 20.0}\n/**:\n  ros__parameters: {rate: 30.0}\n"
    )
    launch, file = tmp_path / "robot.launch.xml", tmp_path / "robot.stride"
    launch.write_text(LAUNCH.replace("TEXT", "y" * 9000))
    imported = midstride("import", str(launch), "-o", str(file), AMENT_PREFIX_PATH=str(prefix), GONE="1")
    assert imported.status == 0, imported.err
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=120, AMENT_PREFIX_PATH=str(prefix), GONE="1")
    try:
        assert up.status == 0, up.err
        first, second, third = (found(midstride, name) for name in ("robot/first", "second", "third"))
    finally:
        assert midstride("down", timeout=120).status == 0
    assert first["words"] == ["--label", "two words", ""] and second["words"] == ["--x"] and third["words"] == []
    assert first["name"] == "/robot/first" and second["name"] == "/second" and third["name"] == "/third"
    assert first["topic"] == "/there" and third["topic"] == "/out"
    assert (first["rate"], first["list"], first["text"]) == (40.0, ["a, b", "c"], 9000) and third["rate"] == 30.0
    assert (first["variable"], third["variable"]) == (None, "a b")
    assert not first["unset"] and not third["unset"] and second["unset"] is False
    assert third["niceness"] == first["niceness"] + 3
    assert not any("ros2" in each["parent"].split("\0")[:2] for each in (first, second, third))
