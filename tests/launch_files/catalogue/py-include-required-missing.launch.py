from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                AnyLaunchDescriptionSource([FindPackageShare("made_up_pkg"), "/launch/required.launch.xml"])
            )
        ]
    )
