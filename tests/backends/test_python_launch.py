"""A launch file in Python is carried out by ROS's own `launch`, where that is; it is on no package index."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from midstride.launch_files.importing import import_launch_file

LAUNCH = """
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, LogInfo, OpaqueFunction, TimerAction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushRosNamespace

print("noise")
n = LaunchConfiguration("n")


def more(context):
    return [Node(executable="/bin/more", name="more_" + n.perform(context))]


def generate_launch_description():
    a = Node(
        executable="a", package="demo", name="a", arguments=["--x", n], parameters=[{"deep": {"k": "v"}}],
        remappings=[("in", "/out")],
    )
    return LaunchDescription([
        DeclareLaunchArgument("n", default_value="3"),
        GroupAction([PushRosNamespace("g"), a]),
        Node(executable="/bin/no", name="no", condition=IfCondition("false")),
        OpaqueFunction(function=more), LogInfo(msg="x"), TimerAction(period=1.0, actions=[]),
    ])
"""


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="ROS 2's launch is on no package index")
def test_its_nodes_are_noted_and_nothing_is_started(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    file.write_text(LAUNCH)
    found = import_launch_file(file, {"n": "7"}, {}, tmp_path, run_python=True)
    assert [each.kind for each in found.findings] == ["unsupported", "package"]
    assert 'run "a --x 7 --ros-args -r in:=/out" package "demo" gate preload' in found.text
    assert 'deep.k = "v"' in found.text and "node more_7 : More" in found.text and "namespace g {" in found.text
    assert found.nodes == 2
