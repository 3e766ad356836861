from launch import LaunchDescription
from launch.actions import SetLaunchConfiguration, TimerAction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            SetLaunchConfiguration("a", "1"),
            TimerAction(
                period=3.0,
                actions=[
                    Node(package="made_up_pkg", executable="worker", name="n", arguments=[LaunchConfiguration("a")])
                ],
            ),
            SetLaunchConfiguration("a", "2"),
        ]
    )
