from launch import LaunchDescription
from launch.substitutions import ThisLaunchFileDir
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterFile


def generate_launch_description():
    shared = ParameterFile([ThisLaunchFileDir(), "/cameras.yaml"], allow_substs=True)
    return LaunchDescription(
        [
            Node(package="made_up_pkg", executable="worker", name="front", parameters=[shared]),
            Node(package="made_up_pkg", executable="worker", name="rear", parameters=[shared]),
        ]
    )
