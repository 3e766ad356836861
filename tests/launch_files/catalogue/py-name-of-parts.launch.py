from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [Node(package="made_up_pkg", executable="worker", name=["a_", LaunchConfiguration("x", default="b")])]
    )
