from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("a", default_value="x"),
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                condition=IfCondition(PythonExpression(["'", LaunchConfiguration("a"), "' == 'x'"])),
            ),
        ]
    )
