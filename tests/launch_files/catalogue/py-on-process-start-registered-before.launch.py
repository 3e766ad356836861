from launch import LaunchDescription
from launch.actions import RegisterEventHandler, TimerAction
from launch.event_handlers import OnProcessExit, OnProcessStart
from launch_ros.actions import Node


def worker(name, **options):
    return Node(package="made_up_pkg", executable="worker", name=name, **options)


def generate_launch_description():
    late = worker("late")
    return LaunchDescription(
        [
            RegisterEventHandler(OnProcessStart(target_action=late, on_start=[worker("with_it")])),
            RegisterEventHandler(OnProcessExit(target_action=late, on_exit=[worker("after_it")])),
            TimerAction(period=2.0, actions=[late]),
            worker("m"),
        ]
    )
