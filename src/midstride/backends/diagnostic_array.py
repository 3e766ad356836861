"""``/diagnostics`` on ROS 2 and ROS 1, whose messages are alike; nothing is published where they are not installed."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from midstride.node.diagnostic_status import DiagnosticEntry

# The message class; None where it is not installed.
MESSAGE: Any = None
with suppress(ImportError):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    MESSAGE = DiagnosticArray


def message(entries: Iterable[DiagnosticEntry], node: str, instance: str, now: int) -> Any:
    """The message for the entries of ``instance``, under the name of ``node``, which its replacements share.

    ``now`` is the ROS clock (ns). Before that runs, the stamp is the system's time: the aggregator warns of none.
    """
    array = DiagnosticArray(
        status=[
            DiagnosticStatus(
                level=getattr(DiagnosticStatus, entry.level.name),
                name=f"{node}: {entry.name}",
                message=entry.message,
                hardware_id=instance,
                values=[KeyValue(key=key, value=value) for key, value in entry.values.items()],
            )
            for entry in entries
        ]
    )
    seconds, nanoseconds = divmod(now or time.time_ns(), 1_000_000_000)
    if hasattr(array.header.stamp, "nanosec"):
        array.header.stamp.sec, array.header.stamp.nanosec = seconds, nanoseconds
    else:
        array.header.stamp.secs, array.header.stamp.nsecs = seconds, nanoseconds
    return array
