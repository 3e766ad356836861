from launch import LaunchDescription
from launch.actions import AppendEnvironmentVariable
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [AppendEnvironmentVariable("MADE_UP_SET", "x"), Node(package="made_up_pkg", executable="worker", name="n")]
    )
