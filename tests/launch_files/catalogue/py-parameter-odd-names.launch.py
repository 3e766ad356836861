from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[{"joint-1": 1, "1st": 2, "a b": 3, "a/b": 4, "x: y": 5}],
            )
        ]
    )
