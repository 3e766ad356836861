from launch import LaunchDescription
from launch.actions import GroupAction, TimerAction
from launch_ros.actions import Node, PushROSNamespace


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction(
                [
                    PushROSNamespace("g"),
                    TimerAction(period=3.0, actions=[Node(package="made_up_pkg", executable="worker", name="n")]),
                ]
            )
        ]
    )
