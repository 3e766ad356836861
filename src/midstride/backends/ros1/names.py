"""Names on ROS 1 that are Midstride's own."""

from __future__ import annotations

from typing import Final

# Every component's state, for people and tools to read: JSON in a std_msgs/String.
STATE: Final = "/midstride/state"
# The name under which the manager calls the master's API; no node bears it.
MANAGER: Final = "/midstride_manager"
# Topics of every component's node that are neither ports nor the author's.
INTERNAL: Final = frozenset({"/rosout", STATE})
