"""Names of nodes, topics and services on ROS 1."""

from __future__ import annotations

from typing import Final

from midstride.backends.naming import full as full
from midstride.backends.naming import split as split

STRING: Final = "std_msgs/String"
# Every component's announcements, and every component's state: JSON in a std_msgs/String.
ANNOUNCEMENT: Final = "/midstride/announcement"
STATE: Final = "/midstride/state"
# What the names of managers' nodes begin with.
MANAGER: Final = "/midstride_manager_"
# The type of the command service, whose classes genpy makes from its definition.
COMMAND_TYPE: Final = "midstride/Command"
COMMAND_DEFINITION: Final = "string request\n---\nstring reply\n"


def command_service(node: str) -> str:
    """The service by which the component of ``node`` takes commands."""
    return f"{node}/midstride/command"


def is_ours(name: str) -> bool:
    """Whether a node, topic or service is Midstride's own plumbing."""
    return name in (ANNOUNCEMENT, STATE) or name.startswith(MANAGER) or name.endswith("/midstride/command")
