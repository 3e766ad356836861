from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node


def nothing(context):
    return None


def generate_launch_description():
    return LaunchDescription(
        [OpaqueFunction(function=nothing), Node(package="made_up_pkg", executable="worker", name="n")]
    )
