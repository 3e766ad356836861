from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription([Node(package="made_up_pkg", executable="worker", name="n", parameters=[{"a": [1, "x"]}])])
