from launch import LaunchDescription
from launch.actions import GroupAction
from launch_ros.actions import Node, SetRemap


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction([SetRemap("a", "b"), Node(package="made_up_pkg", executable="worker", name="n")]),
            Node(package="made_up_pkg", executable="worker", name="m"),
        ]
    )
