from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(package="nowhere_pkg", executable="worker", name="n"),
            Node(package="nowhere_pkg", executable="worker", name="m"),
            Node(package="made_up_pkg", executable="worker", name="o"),
        ]
    )
