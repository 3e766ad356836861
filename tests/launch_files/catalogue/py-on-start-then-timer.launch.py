from launch import LaunchDescription
from launch.actions import RegisterEventHandler, TimerAction
from launch.event_handlers import OnProcessStart
from launch_ros.actions import Node


def generate_launch_description():
    first = Node(package="made_up_pkg", executable="worker", name="n")
    return LaunchDescription(
        [
            first,
            RegisterEventHandler(
                OnProcessStart(
                    target_action=first,
                    on_start=[
                        TimerAction(period=2.0, actions=[Node(package="made_up_pkg", executable="worker", name="m")])
                    ],
                )
            ),
        ]
    )
