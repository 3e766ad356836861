from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    shared = {"a": 1, "b": ["u", "v"]}
    return LaunchDescription(
        [
            Node(package="made_up_pkg", executable="worker", name="n", parameters=[shared]),
            Node(package="made_up_pkg", executable="worker", name="second", parameters=[shared]),
        ]
    )
