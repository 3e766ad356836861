"""A launch file in Python is carried out by ROS's own `launch`, where that is; it is on no package index."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest

from midstride.backends.ros2.manager.python_launch import _line_in
from midstride.errors import SpecificationError
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
    found = import_launch_file(file, {"n": "7"}, dict(os.environ), None, run_python=True)
    assert [each.kind for each in found.findings] == ["package"]
    assert 'run "a --x 7 --ros-args -r in:=/out" package "demo" gate preload' in found.text
    assert 'deep.k = "v"' in found.text and "node more_7 : More" in found.text and "namespace g {" in found.text
    assert found.nodes == 2


LATER = """
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node


def fails(context):
    raise ValueError("no luck")


def generate_launch_description():
    return LaunchDescription([
        Node(package="nix", executable="a", name="a"),
        Node(package="nix", executable="b", name="b"),
        OpaqueFunction(
            function=fails),
        Node(executable="/bin/c", name="c"),
    ])
"""


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="ROS 2's launch is on no package index")
def test_findings_have_their_lines_and_a_missing_package_is_one(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    file.write_text(LATER)
    found = import_launch_file(file, {}, dict(os.environ), None, run_python=True)
    places = [(each.kind, each.place.rpartition(":")[2]) for each in found.findings]
    assert places == [("package", "13"), ("python", "15")]
    assert found.nodes == 3


@pytest.mark.skipif(importlib.util.find_spec("launch") is not None, reason="here is ROS 2's launch")
def test_where_there_is_no_launch_the_file_is_not_run(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    with pytest.raises(
        SpecificationError, match=r"ROS's `launch` cannot be imported .*; source the setup file of your ROS"
    ):
        import_launch_file(file, {}, dict(os.environ), None, run_python=True)
    assert not (tmp_path / "ran").exists()


def test_the_line_of_an_error_is_the_last_one_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    for text, line in (("x = 1\nimport json\njson.loads('{')\n", 3), ("x = (\n", 1)):
        file.write_text(text)
        with pytest.raises((ValueError, SyntaxError)) as caught:
            exec(compile(text, str(file), "exec"), {})
        assert _line_in(caught.value, str(file)) == (str(file), line)
        assert _line_in(caught.value, str(tmp_path / "other.launch.py")) is None


LIFECYCLE = """
from launch import LaunchDescription
from launch.actions import EmitEvent, RegisterEventHandler, Shutdown
from launch.events import matches_action
from launch_ros.actions import LifecycleNode, LifecycleTransition, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition


def change(node, transition):
    return EmitEvent(event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition))


def generate_launch_description():
    pump, lamp, idle = (
        LifecycleNode(executable=f"/bin/{name}", name=name, namespace="") for name in ("pump", "lamp", "idle")
    )
    return LaunchDescription([
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=pump, goal_state="inactive", entities=[change(pump, Transition.TRANSITION_ACTIVATE)],
        )),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=pump, goal_state="active", entities=[Node(executable="/bin/mission", name="mission")],
        )),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=pump, goal_state="finalized", entities=[Shutdown()],
        )),
        change(pump, Transition.TRANSITION_CONFIGURE),
        pump,
        lamp,
        LifecycleTransition(lifecycle_node_names=["/lamp"], transition_ids=[1, 3]),
        idle,
        change(idle, Transition.TRANSITION_ACTIVATE),
    ])
"""


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="ROS 2's launch is on no package index")
def test_lifecycle_nodes_are_taken_through_the_states_that_launch_takes_them_through(tmp_path: Path) -> None:
    (tmp_path / "robot.launch.py").write_text(LIFECYCLE)
    found = import_launch_file(tmp_path / "robot.launch.py", {}, dict(os.environ), None, run_python=True)
    said = [finding.message for finding in found.findings if finding.kind == "lifecycle"]
    assert [" ".join(message.split()[:4]) for message in said] == [
        "launch activates `pump` by",
        "launch activates `lamp` by",
        "the launch file leaves",
    ]
    assert "leaves `idle` unconfigured" in said[2]
    left = [finding.message for finding in found.findings if finding.left_out]
    assert left == [
        "`ChangeState` (activate) of `idle`, which is unconfigured, is left out",
        "what is done on an event (`OnStateTransition`) that nothing here causes is left out",
    ]
    (later,) = (finding.message for finding in found.findings if finding.kind == "later")
    assert "`mission` is started when `pump` has become active" in later and found.nodes == 4


COMPONENTS = """
from launch import LaunchDescription
from launch_ros.actions import ComposableNodeContainer, LoadComposableNodes, Node, PushRosNamespace
from launch_ros.descriptions import ComposableNode

def generate_launch_description():
    return LaunchDescription([
        PushRosNamespace("front"),
        ComposableNodeContainer(
            package="rclcpp_components", executable="component_container_mt", name="pipeline", namespace="",
            composable_node_descriptions=[
                ComposableNode(
                    package="cameras", plugin="cameras::Camera", name="camera", remappings=[("image", "/image")],
                    parameters=[{"gain": 2, "lens": {"focus": 0.5}}],
                    extra_arguments=[{"use_intra_process_comms": True}, {"enable_rosout": False}],
                ),
            ],
        ),
        Node(package="rclcpp_components", executable="component_container_isolated", name="box"),
        LoadComposableNodes(target_container="box", composable_node_descriptions=[
            ComposableNode(package="planners", plugin="planners::Planner", name="planner", namespace="/other"),
        ]),
        LoadComposableNodes(target_container="/elsewhere", composable_node_descriptions=[
            ComposableNode(package="routes", plugin="routes::Route", name="route"),
        ]),
    ])
"""


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="ROS 2's launch is on no package index")
def test_components_of_a_python_launch_file_get_a_process_each_or_share_one_as_there(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    file.write_text(COMPONENTS, encoding="utf-8")
    found = import_launch_file(file, {}, dict(os.environ), None, run_python=True, containers="split")
    assert 'run component "cameras::Camera -r image:=/image -e enable_rosout:=false" package "cameras"' in found.text
    assert 'in "component_container_mt" gate preload' in found.text
    assert "gain = 2" in found.text
    assert "lens.focus = 0.5" in found.text
    assert 'run component "planners::Planner" package "planners" in "component_container_isolated"' in found.text
    assert 'run component "routes::Route" package "routes" gate preload' in found.text
    assert "namespace other {" in found.text
    assert found.nodes == 3
    omitted = import_launch_file(file, {}, dict(os.environ), None, run_python=True, containers="omit")
    assert [each.kind for each in omitted.findings].count("composable") == 3
    kept = import_launch_file(file, {}, dict(os.environ), None, run_python=True)
    words = " ".join(kept.text.split())
    assert 'container /front/pipeline { run "component_container_mt" package "rclcpp_components" }' in words
    assert "node camera : Camera in /front/pipeline" in words and "node planner : Planner in /front/box" in words
