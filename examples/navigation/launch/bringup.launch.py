from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("nav_demo")
    parameters = LaunchConfiguration("params_file")
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=PathJoinSubstitution([share, "nav2_params.yaml"])),
            DeclareLaunchArgument("slam", default_value="true"),
            ExecuteProcess(cmd=["mkdir", "-p", "maps"], name="make_folder"),
            Node(package="nav_demo", executable="set_pose", name="set_pose"),
            Node(package="nav_demo", executable="base_driver", parameters=[parameters]),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "navigation.launch.py"])),
                launch_arguments={"params_file": parameters}.items(),
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(
                    PathJoinSubstitution([FindPackageShare("slam_toolbox"), "launch", "online_async_launch.py"])
                ),
                condition=IfCondition(LaunchConfiguration("slam")),
            ),
        ]
    )
