from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterFile

LIFECYCLE_NODES = ["controller_server", "planner_server"]


def generate_launch_description() -> LaunchDescription:
    parameters = ParameterFile(LaunchConfiguration("params_file"), allow_substs=True)
    nodes = [
        Node(package="nav_demo", executable=name, name=name, parameters=[parameters], respawn=True, respawn_delay=2.0)
        for name in LIFECYCLE_NODES
    ]
    manager = Node(
        package="nav_demo",
        executable="lifecycle_manager",
        name="lifecycle_manager_navigation",
        parameters=[{"autostart": True}, {"node_names": LIFECYCLE_NODES}],
    )
    return LaunchDescription([DeclareLaunchArgument("params_file"), *nodes, manager])
