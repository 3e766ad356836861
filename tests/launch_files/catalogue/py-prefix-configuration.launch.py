from launch import LaunchDescription
from launch.actions import SetLaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [SetLaunchConfiguration("launch-prefix", "nice"), Node(package="made_up_pkg", executable="worker", name="n")]
    )
