"""A bare node that publishes ``/clock`` 200 times a second, until its standard input ends.

A line on standard input, ``SPEED [SECONDS]``, sets its speed, and what it shows. At its end it writes the moments at
which it moved to the file it is given: pairs of the steady clock and its time (ns).
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from pathlib import Path

import rclpy
from rosgraph_msgs.msg import Clock

INTERVAL = 0.005


def main(path: str, speed: float, ros: float) -> None:
    rclpy.init()
    node = rclpy.create_node("clock_source")
    publisher = node.create_publisher(Clock, "/clock", 10)
    moments: list[tuple[int, int]] = []
    shown, last = round(ros * 1e9), time.monotonic_ns()
    while True:
        if select.select([0], [], [], INTERVAL)[0]:
            words = os.read(0, 1000).decode().split()
            if not words:
                break
            speed = float(words[0])
            shown = round(float(words[1]) * 1e9) if len(words) > 1 else shown
        now = time.monotonic_ns()
        shown, last = shown + round((now - last) * speed), now
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(shown, 1_000_000_000)
        publisher.publish(message)
        moments.append((now, shown))
    Path(path).write_text(json.dumps(moments))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
