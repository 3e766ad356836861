from launch import LaunchDescription
from launch.actions import SetLaunchConfiguration
from launch.substitutions import LaunchConfiguration, ThisLaunchFileDir
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            SetLaunchConfiguration("file", [ThisLaunchFileDir(), "/only_wild.yaml"]),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[LaunchConfiguration("file"), {"other": 6}],
            ),
        ]
    )
