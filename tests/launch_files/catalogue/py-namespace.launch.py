from launch import LaunchDescription
from launch_ros.actions import Node, PushROSNamespace


def generate_launch_description():
    return LaunchDescription(
        [PushROSNamespace("g"), Node(package="made_up_pkg", executable="worker", name="n", namespace="h")]
    )
