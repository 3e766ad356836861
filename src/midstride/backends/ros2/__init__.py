"""ROS 2: what a component's process is given (:func:`create_host`), and the manager's side (:func:`create_backend`).

Importing this package imports no ROS: that happens where one of the two is called, and a clear error
says so where there is none.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from midstride.errors import BackendError

if TYPE_CHECKING:
    from midstride.backends.ros2.backend import Ros2Backend
    from midstride.backends.ros2.host import Ros2Host
    from midstride.runtime.reaper import Reaper

__all__ = ["create_backend", "create_host"]


def _require_rclpy() -> None:
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise BackendError(
            f"ROS 2 cannot be imported ({error}): source your ROS's setup file, "
            "or `pip install '.[ros2]'` in a clone of Midstride"
        ) from error


def create_host(name: str, namespace: str) -> Ros2Host:
    """Join ROS 2 as the component ``name``. Raises BackendError where that is not possible."""
    _require_rclpy()
    from midstride.backends.ros2.host import Ros2Host

    return Ros2Host(name, namespace)


def create_backend(
    *, logs: Path | None = None, guardian: Reaper | None = None, tuned: bool = True, use_sim_time: bool = False
) -> Ros2Backend:
    """The back end of a manager. ``logs``: the folder of the components' logs (default: beside ROS's own).

    ``guardian`` ends what is started should this process be killed. ``tuned`` False leaves the
    middleware's discovery as it comes, as it should be across Wi-Fi. Raises BackendError without ROS 2.
    """
    _require_rclpy()
    from midstride.backends.ros2.backend import Ros2Backend

    return Ros2Backend(logs=logs, guardian=guardian, tuned=tuned, use_sim_time=use_sim_time)
