"""The programs that benchmarks/swap.py runs: publishers at 50 Hz of several kinds, and a bare recorder."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

from std_msgs.msg import String

TOPIC = "/swap"
RATE = 50.0


def identity(name: str) -> str:
    """The first word of what a talker says, by which the recorder knows it."""
    return f"{name}-{os.getpid()} tick"


def source(name: str = "source") -> None:
    """A component that writes at 50 Hz."""
    from midstride import Component

    comp = Component(name)
    out = comp.create_output("out", String)
    talk = comp.create_functionality("talk", outputs=[out])
    said = identity(name)
    talk.set_normal_mode(lambda: out.write(String(data=said)), rate=RATE, outputs=[out])
    talk.set_degraded_mode(lambda: None)
    comp.start()


def sink(queue: str = "10") -> None:
    """A component that relies on what the source writes; ``queue``: how many messages wait for it."""
    from midstride import Component

    comp = Component("sink")
    heard = comp.create_input("in", String, rate=RATE, qos=int(queue))
    listen = comp.create_functionality("listen", inputs=[heard])
    listen.set_normal_mode(lambda message: None, inputs=[heard])
    listen.set_degraded_mode(lambda: None)
    comp.start()


def bare(name: str) -> None:
    """A plain node that writes at 50 Hz from its start."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node(name)
    publisher = node.create_publisher(String, TOPIC, 10)
    said = identity(name)
    node.create_timer(1 / RATE, lambda: publisher.publish(String(data=said)))
    rclpy.spin(node)


def lifecycle(name: str) -> None:
    """A lifecycle node: it writes while it is active."""
    import rclpy
    from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

    class Source(LifecycleNode):  # type: ignore[misc]  # rclpy has no stubs
        def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
            self.out = self.create_lifecycle_publisher(String, TOPIC, 10)
            self.timer = self.create_timer(1 / RATE, self.tick)
            return TransitionCallbackReturn.SUCCESS

        def tick(self) -> None:
            if self.out.is_activated:
                self.out.publish(String(data=said))

    said = identity(name)
    rclpy.init()
    rclpy.spin(Source(name))


def recorder(path: str, queue: str = "10", known_by: str = "gid") -> None:
    """A subscriber that knows nothing of anybody; writes its rows to ``path`` on SIGTERM, none at its first.

    ``queue``: how many messages wait for it. ``known_by``: a publisher is known by the `gid` that ROS gives, if it
    gives one, or by the first `word` of what it says.
    """
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("recorder")
    rows: list[tuple[int, Any, Any, Any]] = []
    going = [True]

    def take(message: Any, info: dict[str, Any]) -> None:
        if not rows:
            Path(path).write_text("[]")  # so that one can wait for it to hear
        gid = info.get("publisher_gid")
        publisher = None if gid is None else str(gid["data"] if isinstance(gid, dict) else gid)
        if known_by == "word":
            publisher = message.data.split()[0]
        number = info.get("publication_sequence_number")
        rows.append((time.monotonic_ns(), info.get("source_timestamp"), number, publisher))

    def end(signum: int, frame: FrameType | None) -> None:
        going[0] = False

    signal.signal(signal.SIGTERM, end)
    node.create_subscription(String, TOPIC, take, int(queue))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while going[0]:
        executor.spin_once(timeout_sec=0.1)
    Path(path).write_text(json.dumps(rows))


if __name__ == "__main__":
    kinds: dict[str, Callable[..., None]] = {
        "source": source,
        "sink": sink,
        "bare": bare,
        "lifecycle": lifecycle,
        "recorder": recorder,
    }
    kinds[sys.argv[1]](*sys.argv[2:])
