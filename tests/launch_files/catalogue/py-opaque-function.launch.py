from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def more(context, name):
    where = LaunchConfiguration("where", default="there").perform(context)
    return [Node(package="made_up_pkg", executable="worker", name=name, namespace=where)]


def generate_launch_description():
    return LaunchDescription([OpaqueFunction(function=more, args=["n"])])
