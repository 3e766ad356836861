from launch import LaunchDescription
from launch.actions import SetLaunchConfiguration, UnsetLaunchConfiguration
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            SetLaunchConfiguration("a", "1"),
            UnsetLaunchConfiguration("a"),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                arguments=[LaunchConfiguration("a", default="none")],
            ),
        ]
    )
