"""Names of nodes, topics and parameters."""

from __future__ import annotations

import re
from typing import Any, Final

from midstride.backends.naming import full as full
from midstride.backends.naming import split as split

PARAMETER_EVENTS: Final = "/parameter_events"
# Topics that every node has, and that belong to no port.
OF_EVERY_NODE: Final = frozenset({PARAMETER_EVENTS, "/rosout"})
# What a component's state is shown under, and its parameter with the whole of it, as JSON.
PREFIX: Final = "midstride."
STATE: Final = PREFIX + "state"


_CONTROL: Final = re.compile(r"(?P<inside>.*/)_(?P<instance>\w+?)_control(?:_of_(?P<node>\w+))?\Z")


def control(instance: str, node: str) -> str:
    """The hidden node beside ``node``, in the process of ``instance``: the one name there that is the instance's."""
    return f"_{instance}_control" + (f"_of_{node}" if node != instance else "")


def controlled(full_name: str) -> tuple[str, str] | None:
    """The full names of the instance and of its node, for that of a control node; None for any other."""
    if (found := _CONTROL.match(full_name)) is None:
        return None
    inside, instance, node = found.group("inside", "instance", "node")
    return inside + instance, inside + (node or instance)


def is_hidden(full_name: str) -> bool:
    """Whether ROS's tools leave the node out: a part of its name starts with an underscore."""
    return "/_" in full_name


def participant(info: Any) -> bytes:
    """Which process has an endpoint of the graph: the first 12 bytes of its identity, by the standard (DDSI-RTPS)."""
    return bytes(info.endpoint_gid)[:12]
