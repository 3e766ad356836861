"""The programs that benchmarks/swap_ros1.py runs: publishers at 50 Hz of several kinds, and a bare recorder."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

from sensor_msgs.msg import Range

TOPIC = "/swap"
RATE = 50.0


def source(*_: str) -> None:
    """A component that writes at 50 Hz."""
    from midstride import Component

    comp = Component("source")
    out = comp.create_output("out", Range)
    talk = comp.create_functionality("talk", outputs=[out])

    def normal() -> None:
        message = Range(range=1.0)
        comp.clock.stamp(message.header.stamp)
        out.write(message)

    talk.set_normal_mode(normal, rate=RATE, outputs=[out])
    talk.set_degraded_mode(lambda: None)
    comp.start()


def sink() -> None:
    """A component that relies on what the source writes."""
    from midstride import Component

    comp = Component("sink")
    heard = comp.create_input("in", Range, rate=RATE)
    listen = comp.create_functionality("listen", inputs=[heard])
    listen.set_normal_mode(lambda message: None, inputs=[heard])
    listen.set_degraded_mode(lambda: None)
    comp.start()


def bare(name: str) -> None:
    """A plain node that writes at 50 Hz from its start."""
    import rospy

    rospy.init_node(name)
    publisher = rospy.Publisher(TOPIC, Range, queue_size=10, tcp_nodelay=True)
    rate = rospy.Rate(RATE)
    while not rospy.is_shutdown():
        message = Range(range=1.0)
        message.header.stamp = rospy.Time.now()
        publisher.publish(message)
        rate.sleep()


def recorder(path: str, *_: str) -> None:
    """A subscriber that knows nothing of anybody; writes its rows to ``path`` on SIGTERM."""
    import rospy

    rows: list[tuple[int, int, int, str]] = []

    def take(message: Any) -> None:
        header = message.header
        rows.append((time.monotonic_ns(), header.stamp.to_nsec(), header.seq, message._connection_header["callerid"]))

    def end(signum: int, frame: FrameType | None) -> None:
        Path(path).write_text(json.dumps(rows))
        os._exit(0)

    rospy.init_node("recorder", disable_signals=True)
    signal.signal(signal.SIGTERM, end)
    rospy.Subscriber(TOPIC, Range, take, tcp_nodelay=True)
    while True:
        time.sleep(1)


if __name__ == "__main__":
    kinds = {"source": source, "sink": sink, "bare": bare, "recorder": recorder}
    kinds[sys.argv[1]](*sys.argv[2:])
