import os

from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                namespace="s",
                parameters=[os.path.join(os.path.dirname(__file__), "only_wild.yaml"), {"max_speed": 0.2}],
            )
        ]
    )
