from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration, TextSubstitution
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                arguments=[["--a=", LaunchConfiguration("x", default="b c")], "--d", TextSubstitution(text="e f")],
            )
        ]
    )
