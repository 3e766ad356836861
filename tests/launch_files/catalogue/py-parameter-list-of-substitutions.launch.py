from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[
                    {
                        "a": [LaunchConfiguration("x", default="1"), "2"],
                        "b": [[LaunchConfiguration("x", default="u")], ["v"]],
                    }
                ],
            )
        ]
    )
