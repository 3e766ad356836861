from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    get_package_share_directory("nowhere_pkg")
    return LaunchDescription([Node(package="made_up_pkg", executable="worker", name="n")])
