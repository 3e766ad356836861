"""The clock an author sees: the node's ROS clock, so that ``use_sim_time`` works."""

from __future__ import annotations

import time
from collections.abc import Awaitable
from typing import Any

from midstride.errors import NodeError
from midstride.node.component_host import Host


class ComponentClock:
    """The ROS clock of the component, so ``use_sim_time`` works; before ``start()``, the system's clock.

    Each component has one, ``Component.clock``; do not create others.
    """

    def __init__(self) -> None:
        self.host: Host | None = None

    def now(self) -> int:
        """The time in nanoseconds; 0 while ``use_sim_time`` is on and nothing has arrived on ``/clock``."""
        return time.time_ns() if self.host is None else self.host.now()

    def seconds(self) -> float:
        """The time in seconds."""
        return self.now() / 1e9

    def stamp(self, time_message: Any) -> Any:
        """Set a time message of ROS 2 or ROS 1 to now, and return it: ``comp.clock.stamp(message.header.stamp)``.

        Raises NodeError for anything else.
        """
        seconds, nanoseconds = divmod(self.now(), 1_000_000_000)
        if hasattr(time_message, "nanosec"):
            time_message.sec, time_message.nanosec = seconds, nanoseconds
        elif hasattr(time_message, "nsecs"):
            time_message.secs, time_message.nsecs = seconds, nanoseconds
        else:
            raise NodeError(
                f"clock.stamp(): {type(time_message).__name__} is not a time message; write clock.stamp(header.stamp)"
            )
        return time_message

    def sleep(self, seconds: float) -> Awaitable[None]:
        """``await comp.clock.sleep(0.5)`` in an async mode function waits for 0.5 s of the ROS clock.

        Without ``await`` it has no effect. Raises NodeError before ``start()``.
        """
        if self.host is None:
            raise NodeError("clock.sleep() belongs in an async mode function, which runs after start()")
        return self.host.pause(seconds)
