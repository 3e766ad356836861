"""A bare rclpy subscriber in this process, with default settings."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def recording(topic: str, hear: Callable[[Any], object]) -> Iterator[None]:
    """While inside, ``hear`` is called with each std_msgs/msg/String on ``topic``, in a thread."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node("recorder", context=context)
    node.create_subscription(String, topic, hear, 100)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
