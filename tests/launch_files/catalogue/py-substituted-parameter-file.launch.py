from launch import LaunchDescription
from launch.actions import SetLaunchConfiguration
from launch.substitutions import ThisLaunchFileDir
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterFile


def generate_launch_description():
    return LaunchDescription(
        [
            SetLaunchConfiguration("frame", "map"),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[ParameterFile([ThisLaunchFileDir(), "/with_var.yaml"], allow_substs=True)],
            ),
        ]
    )
