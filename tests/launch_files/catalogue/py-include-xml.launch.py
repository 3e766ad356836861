from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                AnyLaunchDescriptionSource([FindPackageShare("made_up_pkg"), "/launch/inner.launch.xml"]),
                launch_arguments={"who": "a"}.items(),
            ),
            Node(package="made_up_pkg", executable="worker", name="n", arguments=[LaunchConfiguration("who")]),
        ]
    )
