from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node


def inner(context):
    return [Node(package="made_up_pkg", executable="worker", name="n")]


def outer(context):
    return [OpaqueFunction(function=inner)]


def generate_launch_description():
    return LaunchDescription([OpaqueFunction(function=outer)])
