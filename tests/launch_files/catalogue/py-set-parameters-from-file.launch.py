from launch import LaunchDescription
from launch.substitutions import ThisLaunchFileDir
from launch_ros.actions import Node, SetParametersFromFile


def generate_launch_description():
    return LaunchDescription(
        [
            SetParametersFromFile([ThisLaunchFileDir(), "/only_wild.yaml"]),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
