from launch import LaunchDescription
from launch.actions import SetLaunchConfiguration
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            SetLaunchConfiguration("ns", "x/y"),
            Node(package="made_up_pkg", executable="worker", name="n", namespace=LaunchConfiguration("ns")),
        ]
    )
