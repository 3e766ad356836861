from launch import LaunchDescription
from launch_ros.actions import Node, SetParameter


def generate_launch_description():
    node = Node(package="made_up_pkg", executable="worker", name="n", parameters=[{"z": 1}])
    return LaunchDescription([SetParameter("a", "{a: 1}"), node])
