from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, SetRemap


def generate_launch_description():
    return LaunchDescription(
        [
            SetRemap("a", "/g"),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                remappings=[("a", "/own"), (LaunchConfiguration("x", default="y"), "/z")],
            ),
        ]
    )
