"""A check that a router of Zenoh answers: without one, rmw_zenoh's processes do not find each other."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Callable, Mapping
from typing import Final

Address = tuple[str, int]

# Where rmw_zenoh's own settings have each process look for one.
ROUTER: Final = ("localhost", 7447)
_FILE: Final = "ZENOH_SESSION_CONFIG_URI"
_OVERRIDE: Final = "ZENOH_CONFIG_OVERRIDE"
_PATIENCE: Final = 0.5  # s
_TCP: Final = re.compile(r"tcp/(?:\[(?P<v6>[^\]]+)\]|(?P<name>[^:/?#\[\]]+)):(?P<port>\d{1,5})(?:[?#].*)?\Z", re.DOTALL)


def answers(address: Address) -> bool:
    """Return whether something accepts a connection there."""
    try:
        socket.create_connection(address, _PATIENCE).close()
    except (OSError, OverflowError):  # the latter for a port that there is not
        return False
    return True


def routers(environment: Mapping[str, str]) -> list[Address]:
    """The addresses at which the processes of rmw_zenoh look for a router; empty if that is not known.

    ``ZENOH_CONFIG_OVERRIDE`` is read as rmw_zenoh does it: pairs ``KEY=VALUE`` with ``;`` between them. A file of
    settings (``ZENOH_SESSION_CONFIG_URI``) is not read, nor another transport than TCP tried.
    """
    found = [] if environment.get(_FILE) else [ROUTER]
    for pair in environment.get(_OVERRIDE, "").split(";"):
        key, _, value = pair.partition("=")
        if key == "connect/endpoints":
            found = _tcp_addresses(value)
        elif key == "connect" or key.startswith("connect/endpoints/"):
            found = []
    return found


def _tcp_addresses(value: str) -> list[Address]:
    """The endpoints of a list in JSON; empty if it is none, or one of them is not over TCP."""
    try:
        stated = json.loads(value)
    except ValueError:
        return []
    if not isinstance(stated, list):
        return []
    matched = [_TCP.match(str(each)) for each in stated]
    return [] if None in matched else [(each["v6"] or each["name"], int(each["port"])) for each in matched if each]


def problem(middleware: str, environment: Mapping[str, str], answering: Callable[[Address], bool] = answers) -> str:
    """A sentence where ``middleware`` is rmw_zenoh and no router answers where it looks; else empty."""
    if middleware != "rmw_zenoh_cpp" or not (looked := routers(environment)) or any(map(answering, looked)):
        return ""
    places = " or ".join(f"tcp/{f'[{host}]' if ':' in host else host}:{port}" for host, port in looked)
    return (
        f"no Zenoh router answers at {places}: the nodes do not find each other until one runs "
        "(`ros2 run rmw_zenoh_cpp rmw_zenohd`)"
    )
