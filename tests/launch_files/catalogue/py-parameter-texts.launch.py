from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[
                    {"a": "1", "b": "true", "c": "1e3", "d": "", "e": "on", "f": "y", "g": "null", "h": "12:30"}
                ],
            )
        ]
    )
