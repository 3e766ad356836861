"""The clock an author sees: the node's ROS clock, so that ``use_sim_time`` works."""

from __future__ import annotations

import time
from collections.abc import Awaitable
from typing import Any

from midstride.errors import NodeError
from midstride.node.host import Host


class ComponentClock:
    """The ROS clock of the component; before it has started, the system's."""

    def __init__(self) -> None:
        self.host: Host | None = None

    def now(self) -> int:
        """Nanoseconds; 0 while ``use_sim_time`` is on and nothing has arrived on ``/clock``."""
        return time.time_ns() if self.host is None else self.host.now()

    def seconds(self) -> float:
        """The same in seconds."""
        return self.now() / 1e9

    def stamp(self, time_message: Any) -> Any:
        """Fill a time message, e.g. ``comp.clock.stamp(message.header.stamp)``, of ROS 2 or ROS 1; returns it.

        Raises NodeError for what is not a time message.
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
        """``await comp.clock.sleep(0.5)`` in an async mode function; elsewhere it has no effect.

        Seconds of the ROS clock. Raises NodeError before the component has started.
        """
        if self.host is None:
            raise NodeError("clock.sleep() belongs in an async mode function, which runs after start()")
        return self.host.pause(seconds)
