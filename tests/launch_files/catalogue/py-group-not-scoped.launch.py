from launch import LaunchDescription
from launch.actions import GroupAction, SetLaunchConfiguration
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, SetParameter


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction([SetLaunchConfiguration("a", "2"), SetParameter("k", 1)], scoped=False),
            Node(package="made_up_pkg", executable="worker", name="n", arguments=[LaunchConfiguration("a")]),
        ]
    )
