from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch.substitutions import ThisLaunchFileDir
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(package="made_up_pkg", executable="worker", name="n"),
            IncludeLaunchDescription(AnyLaunchDescriptionSource([ThisLaunchFileDir(), "/nowhere.launch.py"])),
        ]
    )
