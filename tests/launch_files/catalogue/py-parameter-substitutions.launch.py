from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterValue


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("v", default_value="5"),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[
                    {
                        "a": LaunchConfiguration("v"),
                        "b": [LaunchConfiguration("v"), ".5"],
                        "c": ParameterValue(LaunchConfiguration("v"), value_type=str),
                        "d": [[LaunchConfiguration("v")], [LaunchConfiguration("v")]],
                    }
                ],
            ),
        ]
    )
