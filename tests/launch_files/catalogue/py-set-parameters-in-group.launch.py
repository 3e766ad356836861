from launch import LaunchDescription
from launch.actions import GroupAction
from launch.substitutions import ThisLaunchFileDir
from launch_ros.actions import Node, SetParametersFromFile


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction([SetParametersFromFile([ThisLaunchFileDir(), "/only_wild.yaml"])]),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
