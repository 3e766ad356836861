"""The platforms Midstride runs on. Only the packages in here import a ROS library, and only when asked for."""

from __future__ import annotations

import asyncio
import importlib.util
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, Final, TypeVar

from midstride.backends import ros1, ros2
from midstride.errors import BackendError
from midstride.node.process_context import installed

if TYPE_CHECKING:  # the process of a component imports this package, and none of those
    from midstride.runtime.backend_protocol import Backend
    from midstride.runtime.process.reaper import Reaper
    from midstride.runtime.workspace import Workspace

PUBLIC = "KEPT_OF_LOG LONGEST_LOG listens message_class"

T = TypeVar("T")

NAMES: Final = ("ros2", "ros1", "sim")


def make(
    name: str, workspace: Workspace, *, guardian: Reaper | None = None, middleware_settings: bool = True
) -> Backend:
    """The back end called ``name``. Raises BackendError where it is unknown or cannot be had here.

    Control sockets and logs go to ``workspace``; ``guardian`` ends what is started should this process be killed, which
    the simulator does not need: its components live in this process. ``middleware_settings``: whether ROS 2's processes
    get Midstride's transports and discovery.
    """
    match name:
        case "sim":
            from midstride.backends.simulator import Simulator

            return Simulator(logs=workspace.logs)
        case "ros2":
            return ros2.create_backend(
                workspace.components,
                logs=workspace.logs,
                guardian=guardian,
                middleware_settings=middleware_settings,
            )
        case "ros1":
            return ros1.create_backend(workspace.components, logs=workspace.logs, guardian=guardian)
    raise BackendError(f"there is no back end {name}; there are {', '.join(NAMES)}")


def run(name: str, main: Coroutine[Any, Any, T]) -> T:
    """``asyncio.run`` for what uses the back end ``name``: the simulator's time passes only while nothing computes."""
    if name != "sim":
        return asyncio.run(main)
    from midstride.backends.simulator import run_paced

    return run_paced(main)


def available(name: str) -> bool:
    """Return whether the back end ``name`` can be had here, without importing any ROS."""
    if name == "ros1":
        return ros1.available()
    return name == "sim" or (name == "ros2" and importlib.util.find_spec("rclpy") is not None)


def default() -> str:
    """The ROS that this Python can import, ROS 2 first; the simulator where there is none."""
    return installed() or "sim"
