"""The platforms Midstride runs on. Only the packages in here import a ROS library, and only when asked for."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Final

from midstride.errors import BackendError

if TYPE_CHECKING:
    from pathlib import Path

    from midstride.runtime.backend import Backend
    from midstride.runtime.guardian import Guardian

NAMES: Final = ("ros2", "sim")


def make(name: str, *, logs: Path | None = None, guardian: Guardian | None = None) -> Backend:
    """The back end called ``name``. Raises BackendError where it is unknown or cannot be had here.

    ``logs`` is the folder of the components' logs, ``guardian`` ends what is started should this
    process be killed; the simulator, whose components live in this process, needs neither.
    """
    if name == "sim":
        from midstride.backends.simulator import Simulator

        return Simulator()
    if name == "ros2":
        from midstride.backends.ros2 import create_backend

        return create_backend(logs=logs, guardian=guardian)
    raise BackendError(f"there is no back end {name}; there are {', '.join(NAMES)}")


def available(name: str) -> bool:
    """Whether the back end ``name`` can be had here, without importing it."""
    return name == "sim" or (name == "ros2" and importlib.util.find_spec("rclpy") is not None)


def default() -> str:
    """ROS 2 where it can be had, else the simulator."""
    return "ros2" if available("ros2") else "sim"
