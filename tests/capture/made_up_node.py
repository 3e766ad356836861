"""A node of a system that is made up (:mod:`tests.capture.probed`), in plain rclpy: `made_up_node.py SEED NODE`."""

from __future__ import annotations

import contextlib
import importlib
import random
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.capture.probed import Output, made_up

TYPES = ("std_msgs/msg/String", "std_msgs/msg/Int32", "sensor_msgs/msg/Range")
# A burst, and the pause before the next one (s).
BURST, PAUSE = 1.0, 9.0


def type_of(topic: str) -> str:
    return TYPES[_number(topic) % len(TYPES)]


def is_reliable(topic: str) -> bool:
    return _number(topic) % 2 == 0


def is_latched(topic: str) -> bool:
    return _number(topic) % 5 == 0


def _number(topic: str) -> int:
    return sum(topic.encode())


class MadeUpNode:
    """Does what the gates of tests.capture.probed count."""

    def __init__(self, seed: int, name: str) -> None:
        from rclpy.node import Node

        inputs, outputs = made_up(seed).nodes[name]
        self.node = Node(name.strip("/"))
        self.chance = random.Random(f"{seed} {name}")
        self.heard = dict.fromkeys(inputs, -1e9)
        self.on: dict[str, list[Callable[[], None]]] = {topic: [] for topic in inputs}
        self.begun = time.monotonic()
        for output in outputs:
            self.produce(output)
        for topic in inputs:
            self.node.create_subscription(*self.contract(topic), partial(self.hear, topic), self.qos(topic))

    @staticmethod
    def contract(topic: str) -> tuple[Any, str]:
        package, kind, name = type_of(topic).split("/")
        return getattr(importlib.import_module(f"{package}.{kind}"), name), topic

    @staticmethod
    def qos(topic: str) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        return QoSProfile(
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE if is_reliable(topic) else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched(topic) else DurabilityPolicy.VOLATILE,
        )

    def hear(self, topic: str, _: object) -> None:
        self.heard[topic] = time.monotonic()
        for then in self.on[topic]:
            then()

    def produce(self, output: Output) -> None:
        type_, topic = self.contract(output.topic)
        publisher = self.node.create_publisher(type_, topic, self.qos(topic))

        def publish() -> None:
            publisher.publish(type_())

        if output.kind == "each":
            for need in output.needs:
                self.on[need].append(publish)
        elif output.kind == "all":
            used = dict.fromkeys(output.needs, -1e9)

            def publish_once_all_are_new() -> None:
                if all(self.heard[need] > at for need, at in used.items()):
                    used.update({need: self.heard[need] for need in used})
                    publish()

            for need in output.needs:
                self.on[need].append(publish_once_all_are_new)
        else:
            self.on_a_timer(output, publish)

    def on_a_timer(self, output: Output, publish: Callable[[], None]) -> None:
        calls = 0

        def tick() -> None:
            nonlocal calls
            calls += 1
            now = time.monotonic()
            silent = any(now - self.heard[need] > output.patience for need in output.needs)
            pausing = output.kind == "bursts" and (now - self.begun) % (BURST + PAUSE) > BURST
            if not (pausing or (silent and (output.kind == "held" or calls % 2))):
                publish()

        rate = 50.0 if output.kind == "bursts" else output.rate
        if output.regular:
            self.node.create_timer(1 / rate, tick)
            return

        def tick_by_chance() -> None:
            tick()
            self.node.destroy_timer(timers.pop())
            timers.append(self.node.create_timer(self.chance.expovariate(rate), tick_by_chance))

        timers = [self.node.create_timer(self.chance.expovariate(rate), tick_by_chance)]


def main(seed: int, name: str) -> None:
    import rclpy
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    made = MadeUpNode(seed, name)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(made.node)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
