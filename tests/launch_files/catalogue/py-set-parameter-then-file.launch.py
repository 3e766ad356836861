import os

from launch import LaunchDescription
from launch_ros.actions import Node, SetParameter


def generate_launch_description():
    return LaunchDescription(
        [
            SetParameter("max_speed", 3.0),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[os.path.join(os.path.dirname(__file__), "only_wild.yaml")],
            ),
        ]
    )
