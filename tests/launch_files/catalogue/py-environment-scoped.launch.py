from launch import LaunchDescription
from launch.actions import GroupAction, SetEnvironmentVariable
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction(
                [SetEnvironmentVariable("MADE_UP", "1"), Node(package="made_up_pkg", executable="worker", name="n")]
            ),
            Node(package="made_up_pkg", executable="worker", name="m"),
        ]
    )
