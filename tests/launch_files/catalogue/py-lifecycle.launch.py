from launch import LaunchDescription
from launch_ros.actions import LifecycleNode


def generate_launch_description():
    return LaunchDescription(
        [LifecycleNode(package="made_up_pkg", executable="worker", name="n", namespace="a", parameters=[{"k": 1}])]
    )
