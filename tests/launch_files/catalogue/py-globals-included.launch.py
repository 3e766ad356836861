from launch import LaunchDescription
from launch.actions import SetEnvironmentVariable, SetLaunchConfiguration
from launch_ros.actions import PushROSNamespace, SetParameter, SetRemap


def generate_launch_description():
    return LaunchDescription(
        [
            SetParameter("wheel_base", 2.8),
            SetLaunchConfiguration("mode", "from_python"),
            SetRemap("a", "b"),
            PushROSNamespace("pushed"),
            SetEnvironmentVariable("MADE_UP", "1"),
        ]
    )
