from launch import LaunchDescription
from launch_ros.actions import Node, SetParameter


def generate_launch_description():
    return LaunchDescription(
        [
            SetParameter("a", "text"),
            SetParameter("b", "7"),
            SetParameter("c", 1.0),
            SetParameter("d", [1, 2]),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
