"""ROS 1: the component's side (:func:`create_host`), and the manager's side (:func:`create_backend`).

Importing this package imports no ROS. The manager's side never does: it calls the ROS master's API itself and may run
beside ROS 2. A component's process has rospy, and no ROS 2 on its ``sys.path``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from midstride.backends import common_messages
from midstride.errors import BackendError

if TYPE_CHECKING:
    from midstride.backends.ros1.backend import Ros1Backend
    from midstride.backends.ros1.host import Ros1Host
    from midstride.runtime.process.reaper import Reaper

__all__ = ["available", "create_backend", "create_host", "load", "prepare"]


def available() -> bool:
    """Return whether an interpreter is known in which components of ROS 1 can run."""
    from midstride.backends.ros1.launching import interpreter

    return interpreter() is not None


def load() -> None:
    """Import what a component needs; it joins later, since a process has one node on ROS 1."""
    from midstride.backends.ros1 import host  # noqa: F401
    from midstride.node.author import component_class  # noqa: F401

    list(common_messages.types("rospy"))


prepare = load


def create_host(name: str, namespace: str) -> Ros1Host:
    """Join ROS 1 as the component ``name``. Raises BackendError or NodeError."""
    try:
        import rospy  # noqa: F401
    except ImportError as error:
        raise BackendError(
            f"ROS 1 cannot be imported ({error}): apt install python3-rospy, and run this with the system's Python "
            "or in a virtual environment with --system-site-packages"
        ) from error
    from midstride.backends.ros1.host import Ros1Host
    from midstride.backends.ros1.launching import ENV_NODE

    return Ros1Host(name, namespace, os.environ.get(ENV_NODE, ""))


def create_backend(control: Path, *, logs: Path | None = None, guardian: Reaper | None = None) -> Ros1Backend:
    """See :class:`..processes.ProcessBackend`. Raises BackendError where no interpreter with ROS 1 is known."""
    from midstride.backends.ros1.backend import Ros1Backend
    from midstride.backends.ros1.launching import require_interpreter

    require_interpreter()
    return Ros1Backend(control, logs=logs, guardian=guardian)
