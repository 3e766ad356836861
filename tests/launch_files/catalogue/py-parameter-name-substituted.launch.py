from launch import LaunchDescription
from launch.substitutions import TextSubstitution
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[{(TextSubstitution(text="a"), "b"): 1}],
            )
        ]
    )
