"""The interpreter and the environment of ROS 1's processes.

The manager needs no ROS 1 itself, so it may run in an environment of ROS 2. The processes that it starts never see
that one: two ROS on one ``sys.path`` break each other's messages.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from midstride.backends.common import drop_paths
from midstride.errors import BackendError
from midstride.runtime.process.reaper import environment_value

# Names the interpreter in which components run, and which has rospy, rosmaster and Midstride.
ENV_PYTHON: Final = "MIDSTRIDE_ROS1_PYTHON"
# The environment that `make test` sets up, beside the one the manager runs in.
BESIDE: Final = ".venv-ros1"
MASTER_URI: Final = "ROS_MASTER_URI"
# A node's namespace: rospy reads it when it is imported.
NAMESPACE: Final = "ROS_NAMESPACE"
# The name of a component's node, where it is not that of its instance.
ENV_NODE: Final = "MIDSTRIDE_ROS1_NODE"
DEFAULT_MASTER: Final = "http://localhost:11311"
LOOPBACK: Final = "127.0.0.1"

_LOCAL: Final = ("localhost", "127.0.0.1", "::1")
# Set by a sourced ROS 2 or by its wheels, for ROS 2 alone.
_OF_ROS2: Final = (
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
    "AMENT_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "RMW_IMPLEMENTATION",
    "ROS_DOMAIN_ID",
)
_VERSION_OF_ROS2: Final = ("ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION")


def interpreter() -> str | None:
    """The Python in which components run; None where no Python with ROS 1 is known."""
    if named := os.environ.get(ENV_PYTHON):
        return named
    if importlib.util.find_spec("rospy") is not None:
        return sys.executable
    beside = Path(sys.prefix).parent / BESIDE / "bin" / "python"
    return str(beside) if os.access(beside, os.X_OK) else None


def require_interpreter() -> str:
    """Raises BackendError, saying what to do, where there is none."""
    found = interpreter()
    if found is None:
        raise BackendError(
            f"ROS 1 was not found: this Python cannot import rospy, and {ENV_PYTHON} names no other. "
            "On Debian 12 and Ubuntu 22.04: apt install python3-rospy python3-rosmaster, then run `tools/ros1`, "
            "or make a virtual environment with --system-site-packages"
        )
    return found


def master_uri(environment: Mapping[str, str]) -> str:
    return environment.get(MASTER_URI) or DEFAULT_MASTER


def master_of(pid: int) -> str:
    """The master that a component's process was started with."""
    return environment_value(pid, MASTER_URI) or DEFAULT_MASTER


def is_local(uri: str) -> bool:
    """Return whether an address is on this machine's loopback."""
    return urlsplit(uri).hostname in _LOCAL


def own_host(environment: Mapping[str, str], uri: str) -> str:
    """The address under which other nodes reach a process of this machine: the user's, else loopback.

    Raises BackendError where the master is elsewhere and the user names no address.
    """
    named = environment.get("ROS_HOSTNAME") or environment.get("ROS_IP")
    if named:
        return named
    if is_local(uri):
        return LOOPBACK
    raise BackendError(f"the ROS master is on another machine ({uri}): set ROS_IP to the address of this one")


def environment(base: Mapping[str, str], uri: str) -> dict[str, str]:
    """The environment of any process of ROS 1: the manager's, without ROS 2. Raises as :func:`own_host`."""
    result = {name: value for name, value in base.items() if name not in _OF_ROS2}
    if "AMENT_PREFIX_PATH" in base or base.get("ROS_VERSION") == "2":
        for name in _VERSION_OF_ROS2:
            result.pop(name, None)
    prefixes = [prefix for prefix in base.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    if "_ROS_WHEELS_BOOTSTRAP_COMPLETE" in base:
        prefixes.append(sys.prefix)

    def is_of_ros2(path: str) -> bool:
        inside = any(Path(path).is_relative_to(prefix) for prefix in prefixes)
        return not path or inside or os.path.isdir(os.path.join(path, "rclpy"))

    for variable in ("PYTHONPATH", "LD_LIBRARY_PATH", "CMAKE_PREFIX_PATH"):
        drop_paths(result, variable, is_of_ros2)
    result[MASTER_URI] = uri
    if not result.get("ROS_HOSTNAME"):
        result["ROS_IP"] = own_host(base, uri)
    result["PYTHONUNBUFFERED"] = "1"
    return result
