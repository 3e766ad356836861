"""Names of nodes, topics and parameters."""

from __future__ import annotations

from typing import Final

from midstride.backends.naming import full as full
from midstride.backends.naming import split as split

PARAMETER_EVENTS: Final = "/parameter_events"
# Topics that every node has, and that belong to no port.
OF_EVERY_NODE: Final = frozenset({PARAMETER_EVENTS, "/rosout"})
# What a component's state is shown under, and its parameter with the whole of it, as JSON.
PREFIX: Final = "midstride."
STATE: Final = PREFIX + "state"


def control(name: str) -> str:
    """The hidden node that serves the parameter services of the node ``name``."""
    return f"_{name}_control"


def is_hidden(full_name: str) -> bool:
    """Whether ROS's tools leave the node out: a part of its name starts with an underscore."""
    return "/_" in full_name
