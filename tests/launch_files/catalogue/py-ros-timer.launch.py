from launch import LaunchDescription
from launch_ros.actions import Node, ROSTimer


def generate_launch_description():
    return LaunchDescription(
        [ROSTimer(period=3.0, actions=[Node(package="made_up_pkg", executable="worker", name="n")])]
    )
