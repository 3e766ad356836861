from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node


def failing(context):
    raise ValueError("made up")


def generate_launch_description():
    return LaunchDescription(
        [
            Node(package="made_up_pkg", executable="worker", name="n"),
            OpaqueFunction(function=failing),
            Node(package="made_up_pkg", executable="worker", name="m"),
        ]
    )
