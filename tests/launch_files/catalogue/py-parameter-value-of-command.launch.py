from launch import LaunchDescription
from launch.substitutions import Command
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterValue


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[{"a": ParameterValue(Command(["echo ", "x"]), value_type=str)}],
            )
        ]
    )
