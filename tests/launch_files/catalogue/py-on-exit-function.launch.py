from launch import LaunchDescription
from launch.actions import ExecuteProcess
from launch_ros.actions import Node


def again(event, context):
    if event.returncode == 0:
        return [Node(package="made_up_pkg", executable="worker", name="m"), ExecuteProcess(cmd=["echo", "done"])]


def generate_launch_description():
    return LaunchDescription([Node(package="made_up_pkg", executable="worker", name="n", on_exit=again)])
