"""The four programs that benchmarks/overhead.py runs: a publisher and a subscriber, each bare and as a component.

Both pairs do the same work on the same message: the time of sending in the header, ``size`` bytes
of data. ``rate`` 0 means: as fast as it goes. Each side prints one line of figures, once ``seconds``
have passed since its first message.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from array import array
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import Image

TOPIC = "/overhead"


class Cost:
    """The processor time of this process per message, all threads, from a tenth of the messages' time on."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.first: float | None = None
        self.warm: tuple[int, float] | None = None  # messages and processor seconds by then
        self.count = 0
        self.told = False

    def tick(self) -> float | None:
        """Count a message. Once the time is over, the microseconds per message, and None ever after."""
        self.count += 1
        if self.told:
            return None
        now = time.monotonic()
        if self.first is None:
            self.first = now
        elif self.warm is None:
            if now - self.first >= self.seconds / 10:
                self.warm = self.count, time.process_time()
        elif now - self.first >= self.seconds:
            self.told = True
            count, used = self.warm
            return (time.process_time() - used) / (self.count - count) * 1e6
        return None


class Sender:
    """Fills and stamps one message after another."""

    def __init__(self, size: int, seconds: float) -> None:
        self.message = Image()
        self.message.data = array("B", bytes(size))
        self.cost = Cost(seconds)

    def next(self) -> Image:
        used = self.cost.tick()
        if used is not None:
            print(json.dumps({"write_us": used}), flush=True)
        now = time.time_ns()
        self.message.header.stamp.sec, self.message.header.stamp.nanosec = divmod(now, 1_000_000_000)
        return self.message

    def flat_out(self, write: Callable[[Any], None], seconds: float) -> None:
        time.sleep(0.5)  # discovery is not what is measured
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            write(self.next())


class Receiver:
    """Notes how long each message took."""

    def __init__(self, seconds: float) -> None:
        self.cost = Cost(seconds)
        self.delays: list[int] = []

    def take(self, message: Any) -> None:
        now = time.time_ns()
        stamp = message.header.stamp
        self.delays.append(now - stamp.sec * 1_000_000_000 - stamp.nanosec)
        used = self.cost.tick()
        if used is not None and self.cost.first is not None:
            delays = sorted(self.delays[len(self.delays) // 10 :])  # a tenth for warming up
            print(
                json.dumps(
                    {
                        "count": len(self.delays),
                        "per_second": len(self.delays) / (time.monotonic() - self.cost.first),
                        "median_ms": delays[len(delays) // 2] / 1e6,
                        "p99_ms": delays[len(delays) * 99 // 100] / 1e6,
                        "take_us": used,
                    }
                ),
                flush=True,
            )


def bare(side: str, options: argparse.Namespace) -> None:
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    rclpy.init()
    node = rclpy.create_node(f"bare_{side}")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    if side == "subscriber":
        node.create_subscription(Image, TOPIC, Receiver(options.seconds).take, 10)
    else:
        sender, publisher = Sender(options.size, options.seconds), node.create_publisher(Image, TOPIC, 10)
        if options.rate:
            node.create_timer(1 / options.rate, lambda: publisher.publish(sender.next()))
        else:
            executor.create_task(lambda: sender.flat_out(publisher.publish, 1e9))
    executor.spin()


def component(side: str, options: argparse.Namespace) -> None:
    from midstride import Component

    comp = Component(f"component_{side}")
    if side == "subscriber":
        received = comp.create_input("in", Image)
        function = comp.create_functionality("receive", inputs=[received])
        function.set_normal_mode(Receiver(options.seconds).take, inputs=[received])
    else:
        out = comp.create_output("out", Image)
        sender, function = Sender(options.size, options.seconds), comp.create_functionality("send", outputs=[out])
        if options.rate:
            function.set_normal_mode(lambda: out.write(sender.next()), rate=options.rate, outputs=[out])
        else:
            function.set_normal_mode(lambda: sender.flat_out(out.write, 1e9), outputs=[out])
    function.set_degraded_mode(lambda: None)
    comp.start()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=["bare", "component"])
    parser.add_argument("side", choices=["publisher", "subscriber"])
    parser.add_argument("--size", type=int, default=100)
    parser.add_argument("--rate", type=float, default=100)
    parser.add_argument("--seconds", type=float, default=3)
    options, rest = parser.parse_known_args()
    sys.argv = [sys.argv[0], *rest]
    (bare if options.kind == "bare" else component)(options.side, options)


if __name__ == "__main__":
    main()
