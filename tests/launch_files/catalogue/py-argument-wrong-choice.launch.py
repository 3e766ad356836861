from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import TextSubstitution
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("a", default_value=[TextSubstitution(text="z")], choices=["x", "y"]),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
