from launch import LaunchDescription
from launch.actions import SetEnvironmentVariable, UnsetEnvironmentVariable
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            SetEnvironmentVariable("MADE_UP", "a b"),
            UnsetEnvironmentVariable("MADE_UP_SET"),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
