"""The distributions of ROS 2, and which one this process uses."""

from __future__ import annotations

import os
from importlib import metadata
from typing import Final

# In their order. Rolling, which has no end, is none of them.
DISTRIBUTIONS: Final = ("humble", "iron", "jazzy", "kilted", "lyrical")
# Which of them has rclpy in that major version.
_OF_RCLPY: Final = {3: "humble", 4: "iron", 7: "jazzy", 9: "kilted", 10: "lyrical"}


def of_this_process() -> str:
    """The name of the distribution that is sourced, else what rclpy's version tells; empty if it does not."""
    if sourced := os.environ.get("ROS_DISTRO", "").strip():
        return sourced
    try:
        major = metadata.version("rclpy").partition(".")[0]
    except metadata.PackageNotFoundError:
        return ""
    return _OF_RCLPY.get(int(major), "") if major.isdigit() else ""
