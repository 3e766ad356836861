"""Names of nodes and of the control plane's services."""

from __future__ import annotations

from typing import Final

from midstride.backends.naming import full as full
from midstride.backends.naming import split as split

STANDARD: Final = (
    "describe_parameters",
    "get_parameters",
    "get_parameter_types",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
PREFIX: Final = "midstride."
COMMAND: Final = PREFIX + "command"
ANNOUNCEMENT: Final = PREFIX + "announcement"
STATE: Final = PREFIX + "state"


def control(name: str) -> str:
    """The hidden node that answers for the node ``name``."""
    return f"_{name}_control"


def is_hidden(full_name: str) -> bool:
    """Whether ROS's tools pass the node over: a part of its name starts with an underscore."""
    return "/_" in full_name
