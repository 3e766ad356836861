from launch import LaunchDescription
from launch.conditions import IfCondition
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(package="made_up_pkg", executable="worker", name="n", condition=IfCondition("maybe")),
            Node(package="made_up_pkg", executable="worker", name="m"),
        ]
    )
