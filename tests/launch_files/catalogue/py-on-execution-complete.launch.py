from launch import LaunchDescription
from launch.actions import OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnExecutionComplete
from launch_ros.actions import Node


def worker(name, **options):
    return Node(package="made_up_pkg", executable="worker", name=name, **options)


def generate_launch_description():
    first, function = worker("n"), OpaqueFunction(function=lambda context: None)
    return LaunchDescription(
        [
            RegisterEventHandler(OnExecutionComplete(target_action=first, on_completion=[worker("after_n")])),
            RegisterEventHandler(OnExecutionComplete(target_action=function, on_completion=[worker("after_it")])),
            first,
            function,
            RegisterEventHandler(OnExecutionComplete(target_action=worker("k"), on_completion=[worker("never")])),
        ]
    )
