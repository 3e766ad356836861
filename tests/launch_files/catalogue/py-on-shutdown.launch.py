from launch import LaunchDescription
from launch.actions import LogInfo, RegisterEventHandler
from launch.event_handlers import OnShutdown
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(package="made_up_pkg", executable="worker", name="n"),
            RegisterEventHandler(OnShutdown(on_shutdown=[LogInfo(msg="bye")])),
        ]
    )
