from launch import LaunchDescription
from launch.actions import RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit, OnProcessStart
from launch_ros.actions import Node


def worker(name, **options):
    return Node(package="made_up_pkg", executable="worker", name=name, **options)


def generate_launch_description():
    first = worker("n", condition=IfCondition("false"))
    return LaunchDescription(
        [
            first,
            RegisterEventHandler(OnProcessStart(target_action=first, on_start=[worker("never")])),
            RegisterEventHandler(OnProcessExit(target_action=first, on_exit=[worker("nor_this")])),
            worker("m"),
        ]
    )
