from launch import LaunchDescription
from launch.actions import RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            RegisterEventHandler(OnProcessExit(on_exit=[Node(package="made_up_pkg", executable="worker", name="m")])),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
