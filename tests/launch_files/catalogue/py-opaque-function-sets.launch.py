from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def setting(context):
    context.launch_configurations["a"] = "from a function"


def generate_launch_description():
    return LaunchDescription(
        [
            OpaqueFunction(function=setting),
            Node(package="made_up_pkg", executable="worker", name="n", arguments=[LaunchConfiguration("a")]),
        ]
    )
