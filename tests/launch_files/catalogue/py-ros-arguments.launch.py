from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                ros_arguments=["--log-level", "debug"],
                arguments=["--ros-args", "--log-level", "x:=info", "-r", "a:=b", "-p", "k:=1", "--", "--y"],
            )
        ]
    )
