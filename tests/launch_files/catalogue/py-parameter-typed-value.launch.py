from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterValue


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[
                    {
                        "a": ParameterValue("5", value_type=str),
                        "b": ParameterValue(LaunchConfiguration("x", default="5"), value_type=float),
                        "c": ParameterValue(LaunchConfiguration("x", default="[1, 2]")),
                    }
                ],
            )
        ]
    )
