"""The platforms Midstride runs on. Only the packages in here import a ROS library, and only when asked for."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Final

from midstride.errors import BackendError

if TYPE_CHECKING:
    from midstride.runtime.backend import Backend

NAMES: Final = ("ros2", "sim")


def make(name: str) -> Backend:
    """The back end called ``name``. Raises BackendError where it is unknown or cannot be had here."""
    if name == "sim":
        from midstride.backends.simulator import Simulator

        return Simulator()
    if name == "ros2":
        if not available("ros2"):
            raise BackendError(
                "ROS 2 cannot be imported here: source a distribution's set-up file, or install midstride[ros2]; "
                "the simulator (--backend sim) needs no ROS"
            )
        from midstride.backends.ros2 import Ros2

        return Ros2()
    raise BackendError(f"there is no back end {name}; there are {', '.join(NAMES)}")


def available(name: str) -> bool:
    """Whether the back end ``name`` can be had here, without importing it."""
    return name == "sim" or (name == "ros2" and importlib.util.find_spec("rclpy") is not None)


def default() -> str:
    """ROS 2 where it can be had, else the simulator."""
    return "ros2" if available("ros2") else "sim"
