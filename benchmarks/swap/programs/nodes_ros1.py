"""The programs of the comparison on ROS 1: publishers of two kinds, and a bare recorder."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from types import FrameType
from typing import Any

from content import HEAD, counted, read
from std_msgs.msg import String

TOPIC = "/swap"
# A serialized String begins with its length.
PREFIX = 4


def source(name: str, rate: str, size: str) -> None:
    """A component with Midstride's API that writes at ``rate``."""
    from midstride import Component

    comp = Component(name)
    out = comp.create_output("out", String)
    talk = comp.create_functionality("talk", outputs=[out])
    following = counted(name, int(size))
    talk.set_normal_mode(lambda: out.write(String(data=following())), rate=float(rate), outputs=[out])
    talk.set_degraded_mode(lambda: None)
    comp.start()


def sink(rate: str, queue: str = "10") -> None:
    """A component that relies on what the source writes."""
    from midstride import Component

    comp = Component("sink")
    heard = comp.create_input("in", String, rate=float(rate))
    listen = comp.create_functionality("listen", inputs=[heard])
    listen.set_normal_mode(lambda message: None, inputs=[heard])
    listen.set_degraded_mode(lambda: None)
    comp.start()


def bare(name: str, rate: str, size: str) -> None:
    """A plain node that writes from its start."""
    import rospy

    rospy.init_node(name, anonymous=True)
    publisher = rospy.Publisher(TOPIC, String, queue_size=10, tcp_nodelay=True)
    following, pause = counted(name, int(size)), rospy.Rate(float(rate))
    while not rospy.is_shutdown():
        publisher.publish(String(data=following()))
        pause.sleep()


def recorder(path: str, queue: str = "10") -> None:
    """A subscriber that knows nothing of anybody: a line for each message in ``path``, until SIGTERM."""
    import rospy

    with open(path, "w", encoding="utf-8", buffering=1) as file:

        def take(message: Any) -> None:
            received = time.monotonic_ns()
            print(json.dumps([received, *read(message._buff[PREFIX : PREFIX + HEAD])]), file=file)

        def end(signum: int, frame: FrameType | None) -> None:
            os._exit(0)

        rospy.init_node("recorder", disable_signals=True)
        signal.signal(signal.SIGTERM, end)
        rospy.Subscriber(TOPIC, rospy.AnyMsg, take, queue_size=int(queue), tcp_nodelay=True)
        while True:
            time.sleep(1)


if __name__ == "__main__":
    kinds = {"source": source, "sink": sink, "bare": bare, "recorder": recorder}
    kinds[sys.argv[1]](*sys.argv[2:])
