from launch import LaunchDescription
from launch.actions import ExecuteProcess
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    return LaunchDescription([ExecuteProcess(cmd=[[FindPackageShare("made_up_pkg"), "/tool"], "x"])])
