import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[os.path.join(get_package_share_directory("made_up_pkg"), "config", "p.yaml")],
            )
        ]
    )
