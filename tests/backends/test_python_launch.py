"""A launch file in Python is carried out by ROS's own `launch`, where that is; it is on no package index."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2.manager.python_launch import _Visitor
from midstride.launch_files.launch_import import import_launch_file

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
def test_the_nodes_of_a_python_launch_file_are_noted_and_none_is_started(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    file.write_text(LAUNCH)
    found = import_launch_file(file, {"n": "7"}, {}, tmp_path, run_python=True)
    assert [each.kind for each in found.findings] == ["unsupported", "package"]
    assert 'run "a --x 7 --ros-args -r in:=/out" package "demo" gate preload' in found.text
    assert 'deep.k = "v"' in found.text and "node more_7 : More" in found.text and "namespace g {" in found.text
    assert found.nodes == 2


class Launched:
    """A `Node` of launch_ros, as far as it matters here."""

    UNSPECIFIED_NODE_NAMESPACE = UNSPECIFIED_NODE_NAME = "<unspecified>"
    condition = None
    node_name, node_package, node_executable = "/a", "demo", "a"
    expanded_remapping_rules = None
    _Node__expanded_parameter_arguments = _Node__arguments = None

    def __init__(self, **stated: Any) -> None:
        self.process_description = SimpleNamespace(
            prefix=stated.get("prefix", []), env=stated.get("env"), additional_env=stated.get("additional_env")
        )
        self._Node__ros_arguments = stated.get("ros_arguments")
        self._ExecuteLocal__respawn = stated.get("respawn", False)
        self._ExecuteLocal__sigterm_timeout = stated.get("sigterm_timeout", ["5"])
        self._ExecuteLocal__sigkill_timeout = stated.get("sigkill_timeout", ["5"])

    def _perform_substitutions(self, _: object) -> None:
        pass


@pytest.mark.parametrize(
    ("stated", "option"),
    [
        ({}, None),
        ({"prefix": ["nice"]}, "prefix"),
        ({"env": [(["A"], ["1"])]}, "env"),
        ({"additional_env": [(["A"], ["1"])]}, "additional_env"),
        ({"ros_arguments": ["--log-level", "debug"]}, "ros_arguments"),
        ({"respawn": True}, "respawn"),
    ],
)
def test_what_is_stated_of_a_process_is_not_lost_without_a_word(
    monkeypatch: pytest.MonkeyPatch, stated: dict[str, Any], option: str | None
) -> None:
    """With a `launch` that is made up: the real one is on no package index."""
    context = SimpleNamespace(launch_configurations={}, environment={"KEPT": "1", "GONE": "1"})
    context._set_asyncio_loop = lambda loop: loop.close()
    other = type("Other", (), {})
    actions = SimpleNamespace(ExecuteProcess=other, RegisterEventHandler=other, TimerAction=other, EmitEvent=other)
    monkeypatch.setitem(sys.modules, "launch", SimpleNamespace(actions=actions, LaunchContext=lambda: context))
    ros_actions = SimpleNamespace(Node=Launched, LoadComposableNodes=other)
    monkeypatch.setitem(sys.modules, "launch_ros", SimpleNamespace(actions=ros_actions))
    monkeypatch.setitem(sys.modules, "launch_ros.actions", ros_actions)
    visitor = _Visitor({}, "")
    visitor.visit(Launched(sigterm_timeout=["1", "2.5"], sigkill_timeout=["soon"]))
    assert visitor.nodes.pop()["stop"] == {"sigterm": 12.5}
    visitor.visit(Launched(**stated))
    assert visitor.nodes[-1]["stop"] == {}
    assert visitor.left == ([] if option is None else [("unsupported", f"`{option}` of `a` is left out")])
    del visitor.left[:]
    context.environment = {"KEPT": "1", "NEW": "2"}
    visitor.visit(Launched())
    words = "the environment variable `{}` of `a` is left out"
    assert visitor.left == [("unsupported", words.format(name)) for name in ("GONE", "NEW")]
