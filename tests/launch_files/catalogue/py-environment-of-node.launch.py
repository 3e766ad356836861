from launch import LaunchDescription
from launch.substitutions import EnvironmentVariable
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                additional_env={"MADE_UP": "1", "OTHER": EnvironmentVariable("MADE_UP_SET")},
            )
        ]
    )
