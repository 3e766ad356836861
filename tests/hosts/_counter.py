"""A node that counts at 50 Hz, and keeps what it has counted; `record` writes down what a bare node hears of it."""

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


def record(path: str) -> None:
    """Each message in a line, after the time of its receipt (steady, s)."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile

    rclpy.init()
    node = rclpy.create_node(f"recorder_{os.getpid()}")
    with open(path, "w", buffering=1) as file:
        node.create_subscription(
            String,
            TOPIC,
            lambda message: file.write(f"{time.monotonic():.6f} {message.data}\n"),
            QoSProfile(depth=1000),
        )
        with contextlib.suppress(ExternalShutdownException):
            rclpy.spin(node)


if __name__ == "__main__":
    count() if len(sys.argv) == 1 else record(sys.argv[1])
