from launch import LaunchDescription
from launch.actions import GroupAction
from launch_ros.actions import Node, SetParameter


def generate_launch_description():
    return LaunchDescription(
        [
            SetParameter("use_sim_time", True),
            Node(package="made_up_pkg", executable="worker", name="n"),
            GroupAction(
                [
                    SetParameter("k", 2),
                    Node(package="made_up_pkg", executable="worker", name="m", parameters=[{"a": 1}]),
                ]
            ),
        ]
    )
