"""A node that counts at 50 Hz, and keeps what it has counted; `record` writes down what a bare node hears of it.

`plain` is a node without Midstride's API, whose numbers are those of the periods of the clock.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time

from std_msgs.msg import String

TOPIC = "/count"
RATE = 50.0


def count() -> None:
    from midstride import Component

    comp = Component("counter")
    out = comp.create_output("out", String)
    work = comp.create_functionality("work", outputs=[out])
    counted = 0

    def normal() -> None:
        nonlocal counted
        counted += 1
        out.write(String(data=f"{counted} {comp.instance}"))

    def export_state() -> bytes:
        return str(counted).encode()

    def import_state(state: bytes) -> None:
        nonlocal counted
        counted = int(state)

    work.set_normal_mode(normal, rate=RATE, outputs=[out])
    work.set_degraded_mode(lambda: None)
    comp.on_export_state(export_state)
    comp.on_import_state(import_state)
    comp.start()


def count_plain() -> None:
    import rclpy

    rclpy.init()
    publisher = rclpy.create_node("counter").create_publisher(String, "count", 10)
    number = int(time.time() * RATE)
    while rclpy.ok():
        number += 1
        time.sleep(max(number / RATE - time.time(), 0.0))
        publisher.publish(String(data=f"{number} {os.getpid()}"))


def record(path: str) -> None:
    """Each message in a line, after the times of its receipt (steady, s) and of its publication (system, ns).

    The subscription is reliable, as the node's topic is: a link that loses frames takes no message from it.
    """
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    rclpy.init()
    node = rclpy.create_node(f"recorder_{os.getpid()}")
    with open(path, "w", buffering=1) as file:
        node.create_subscription(
            String,
            TOPIC,
            lambda message, info: file.write(f"{time.monotonic():.6f} {info['source_timestamp']} {message.data}\n"),
            QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE),
        )
        with contextlib.suppress(ExternalShutdownException):
            rclpy.spin(node)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        count()
    elif sys.argv[1] == "plain":
        with contextlib.suppress(KeyboardInterrupt):
            count_plain()
    else:
        record(sys.argv[1])
