from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node, PushROSNamespace
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    return LaunchDescription(
        [
            GroupAction(
                [
                    PushROSNamespace("g"),
                    IncludeLaunchDescription(
                        PythonLaunchDescriptionSource([FindPackageShare("made_up_pkg"), "/launch/inner.launch.py"])
                    ),
                ]
            ),
            Node(package="made_up_pkg", executable="worker", name="n"),
        ]
    )
