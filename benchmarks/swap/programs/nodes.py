"""The programs of the comparison on ROS 2: publishers of several kinds, and a bare recorder."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable
from itertools import takewhile
from types import FrameType
from typing import Any

from content import HEAD, counted, read
from std_msgs.msg import String

TOPIC = "/swap"
# A serialized String begins with a header and its length.
PREFIX = 8


def source(name: str = "source", rate: str = "50", size: str = "100") -> None:
    """A component with Midstride's API that writes at ``rate``."""
    from midstride import Component

    comp = Component(name)
    out = comp.create_output("out", String)
    talk = comp.create_functionality("talk", outputs=[out])
    following = counted(name, int(size))
    talk.set_normal_mode(lambda: out.write(String(data=following())), rate=float(rate), outputs=[out])
    talk.set_degraded_mode(lambda: None)
    comp.start()


def sink(rate: str = "50", queue: str = "10") -> None:
    """A component that relies on what the source writes; ``queue``: how many messages wait for it."""
    from midstride import Component

    comp = Component("sink")
    heard = comp.create_input("in", String, rate=float(rate), qos=int(queue))
    listen = comp.create_functionality("listen", inputs=[heard])
    listen.set_normal_mode(lambda message: None, inputs=[heard])
    listen.set_degraded_mode(lambda: None)
    comp.start()


def bare(name: str, rate: str, size: str, topic: str = TOPIC) -> None:
    """A plain node that writes from its start."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node(name)
    publisher = node.create_publisher(String, topic, 10)
    following = counted(name, int(size))
    node.create_timer(1 / float(rate), lambda: publisher.publish(String(data=following())))
    rclpy.spin(node)


def lifecycle(name: str, rate: str, size: str) -> None:
    """A lifecycle node: it writes while it is active."""
    import rclpy
    from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

    following = counted(name, int(size))

    class Source(LifecycleNode):  # type: ignore[misc]  # rclpy has no stubs
        def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
            self.out = self.create_lifecycle_publisher(String, TOPIC, 10)
            self.timer = self.create_timer(1 / float(rate), self.tick)
            return TransitionCallbackReturn.SUCCESS

        def tick(self) -> None:
            if self.out.is_activated:
                self.out.publish(String(data=following()))

    rclpy.init()
    rclpy.spin(Source(name))


def recorder(path: str, queue: str = "10", known_by: str = "content") -> None:
    """A subscriber that knows nothing of anybody: a line for each message in ``path``, until SIGTERM.

    ``queue``: how many messages wait for it. ``known_by``: time, number and talker of a message are those of its
    `content`, or those that the `middleware` tells, where it tells them.
    """
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("recorder")
    going = [True]

    def told(info: dict[str, Any]) -> tuple[Any, Any, Any]:
        gid = info.get("publisher_gid")
        publisher = None if gid is None else str(gid["data"] if isinstance(gid, dict) else gid)
        return info.get("source_timestamp"), info.get("publication_sequence_number"), publisher

    def end(signum: int, frame: FrameType | None) -> None:
        going[0] = False

    signal.signal(signal.SIGTERM, end)
    with open(path, "w", encoding="utf-8", buffering=1) as file:

        def take(message: bytes, info: dict[str, Any]) -> None:
            received = time.monotonic_ns()
            row = told(info) if known_by == "middleware" else read(message[PREFIX : PREFIX + HEAD])
            print(json.dumps([received, *row]), file=file)

        node.create_subscription(String, TOPIC, take, int(queue), raw=True)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while going[0]:
            executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    kinds: dict[str, Callable[..., None]] = {
        "source": source,
        "sink": sink,
        "bare": bare,
        "lifecycle": lifecycle,
        "recorder": recorder,
    }
    words = takewhile(lambda word: word != "--ros-args", sys.argv[2:])  # the others are for rclpy
    kinds[sys.argv[1]](*words)
