import os

from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    os.environ["MADE_UP"] = "1"
    return LaunchDescription([Node(package="made_up_pkg", executable="worker", name="n")])
