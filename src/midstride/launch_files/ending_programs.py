"""Programs that are known to end when they have done their work: a launch file just lets them.

The rule: what is not restarted (`respawn`) and is one of the programs below, by its package and executable or by its
command, is `once`. Any other one is taken for a program that keeps running; if it ends with status 0 all the same,
`up` says that `once` would state that.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Final

from midstride.launch_files.launched_nodes import LaunchedNode

# By package: executables that set something up, in other nodes or in a simulator, and end.
_OF_PACKAGES: Final = {
    "controller_manager": {"spawner", "spawner.py", "unspawner", "unspawner.py", "hardware_spawner"},
    "ros_gz_sim": {"create", "remove"},
    "ros_ign_gazebo": {"create", "remove"},
    "gazebo_ros": {"spawn_entity.py", "spawn_model"},
}
# The same in ROS 1, where a spawner of controllers keeps running, and unloads them when it is ended.
_OF_ROS_1: Final = {"gazebo_ros": {"spawn_model"}}
# Commands that end, whatever their arguments are.
_COMMANDS: Final = set(
    """true false echo printf mkdir rmdir cp mv rm ln touch chmod chown kill killall pkill sleep date test xacro
    setfont stty v4l2-ctl amixer modprobe sysctl ip ifconfig nmcli""".split()
)
# Of tools with subcommands, those that end; `-1` and the like make one end that would not otherwise.
_SUBCOMMANDS: Final = {
    "ros2": {
        "service": {"call", "list", "type"},
        "param": {"set", "get", "load", "dump", "list"},
        "lifecycle": {"set", "get", "list", "nodes"},
        "component": {"load", "unload", "list"},
        "control": {
            "load_controller", "unload_controller", "set_controller_state", "set_hardware_component_state",
            "switch_controllers", "list_controllers", "list_hardware_components", "list_hardware_interfaces",
        },
        "action": {"send_goal"},
    },
    "gz": {"service": {"-s", "--service"}},
    "ign": {"service": {"-s", "--service"}},
}  # fmt: skip
_ONE_MESSAGE: Final = {"-1", "--once", "-t", "--times"}


def ends(node: LaunchedNode) -> bool:
    """Return whether launch lets the program of ``node`` end, as it is known to."""
    if node.respawn:
        return False
    program, *arguments = node.command
    if node.package:
        return PurePosixPath(program).name in _OF_PACKAGES.get(node.package, ())
    return _command_ends(program, arguments)


def _command_ends(program: str, arguments: Sequence[str]) -> bool:
    name = PurePosixPath(program).name
    if name in _COMMANDS:
        return True
    if name == "rosrun" and len(arguments) > 1:
        return arguments[1] in _OF_ROS_1.get(arguments[0], ())
    if name == "ros2" and arguments[:1] == ["run"] and len(arguments) > 2:
        return arguments[2] in _OF_PACKAGES.get(arguments[1], ())
    if name == "ros2" and arguments[:2] == ["topic", "pub"]:
        return not _ONE_MESSAGE.isdisjoint(arguments)
    return len(arguments) > 1 and arguments[1] in _SUBCOMMANDS.get(name, {}).get(arguments[0], ())
