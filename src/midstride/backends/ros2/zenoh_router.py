"""A check that a router of Zenoh answers: without one, rmw_zenoh's processes do not find each other."""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping
from typing import Final

# Where rmw_zenoh's own settings have each process look for one.
ROUTER: Final = ("localhost", 7447)
# What changes that: then it is not known where a router would be.
_SETTINGS: Final = ("ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE")
_PATIENCE: Final = 0.5  # s


def answers(address: tuple[str, int]) -> bool:
    """Return whether something accepts a connection there."""
    try:
        socket.create_connection(address, _PATIENCE).close()
    except OSError:
        return False
    return True


def problem(
    middleware: str, environment: Mapping[str, str], answering: Callable[[tuple[str, int]], bool] = answers
) -> str:
    """A sentence where ``middleware`` is rmw_zenoh and no router answers where it looks; else empty."""
    if middleware != "rmw_zenoh_cpp" or any(environment.get(name) for name in _SETTINGS) or answering(ROUTER):
        return ""
    return (
        f"no Zenoh router answers at tcp/{ROUTER[0]}:{ROUTER[1]}: the nodes do not find each other until one runs "
        "(`ros2 run rmw_zenoh_cpp rmw_zenohd`)"
    )
