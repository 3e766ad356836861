from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("who", default_value="nobody"),
            Node(package="made_up_pkg", executable="worker", name=["inner_", LaunchConfiguration("who")]),
        ]
    )
