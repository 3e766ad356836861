from launch import LaunchDescription
from launch_ros.actions import ComposableNodeContainer
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    return LaunchDescription(
        [
            ComposableNodeContainer(
                package="made_up_pkg",
                executable="worker",
                name="box",
                namespace="",
                composable_node_descriptions=[
                    ComposableNode(package="made_up_pkg", plugin="made_up::Filter", name="filter")
                ],
            )
        ]
    )
