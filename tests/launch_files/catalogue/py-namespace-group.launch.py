from launch import LaunchDescription
from launch.actions import GroupAction
from launch_ros.actions import Node, PushROSNamespace


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction([PushROSNamespace("g"), Node(package="made_up_pkg", executable="worker", name="n")]),
            Node(package="made_up_pkg", executable="worker", name="m"),
        ]
    )
