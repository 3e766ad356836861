from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="made_up_pkg",
                executable="worker",
                name="n",
                parameters=[
                    {
                        "names": ["a", "b"],
                        "other": 1,
                        "numbers": [1, 2],
                        "reals": [1.0, 2.5],
                        "truths": [True, False],
                        "pair": (1, 2),
                    }
                ],
            )
        ]
    )
