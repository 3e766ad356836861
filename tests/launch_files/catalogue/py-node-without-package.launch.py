from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription([Node(executable="/bin/true", name="n", arguments=["x"])])
