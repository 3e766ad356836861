from launch import LaunchDescription
from launch_ros.actions import LoadComposableNodes
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    return LaunchDescription(
        [
            LoadComposableNodes(
                target_container="/box",
                composable_node_descriptions=[
                    ComposableNode(package="made_up_pkg", plugin="made_up::Filter", name="filter")
                ],
            )
        ]
    )
