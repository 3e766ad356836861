"""What Midstride's middleware settings cost: images between two processes over UDP, and over shared memory.

Two processes of bare rclpy, one that publishes images at 20 Hz and one that receives them: in the environment of a
component, in the user's own, and with LARGE_DATA, which Midstride leaves to the user. The latency is from before
`publish` to the subscriber's callback.
"""

from __future__ import annotations

import argparse
import array
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
from _guard import guard

RATE = 20.0
SIZES = {"64 kB": 1 << 16, "1 MB": 1 << 20, "6 MB": 6 << 20}


def publish(size: int) -> None:
    import rclpy
    from sensor_msgs.msg import Image

    rclpy.init()
    node = rclpy.create_node("image_source")
    publisher = node.create_publisher(Image, "/large_messages", 5)
    message = Image(data=array.array("B", bytes(size)))

    def tick() -> None:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.monotonic_ns(), 1_000_000_000)
        publisher.publish(message)

    node.create_timer(1 / RATE, tick)
    rclpy.spin(node)


def receive(count: int) -> None:
    """Receives so many images after the first ten; prints their latencies (s), and how many were lost."""
    import rclpy
    from sensor_msgs.msg import Image

    rclpy.init()
    node = rclpy.create_node("image_sink")
    found: list[float] = []
    numbers: list[int] = []

    def take(message: Any, info: dict[str, Any]) -> None:
        stamp = message.header.stamp
        found.append((time.monotonic_ns() - stamp.sec * 1_000_000_000 - stamp.nanosec) / 1e9)
        numbers.append(info["publication_sequence_number"])

    node.create_subscription(Image, "/large_messages", take, 5)
    end = time.monotonic() + 20 + 2 * count / RATE
    while len(found) < count + 10 and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    lost = numbers[-1] - numbers[10] + 1 - len(numbers[10:]) if len(numbers) > 10 else None
    print(json.dumps({"latencies": found[10:], "lost": lost}))


def measure(size: int, count: int, environment: dict[str, str]) -> dict[str, Any]:
    command = [sys.executable, str(Path(__file__).resolve())]
    with subprocess.Popen([*command, "--publish", str(size)], env=environment) as source:
        try:
            sink = subprocess.Popen([*command, "--receive", str(count)], env=environment, stdout=subprocess.PIPE)
            time.sleep(5)  # both have found each other
            processes = [psutil.Process(source.pid), psutil.Process(sink.pid)]
            before, begun = used(processes), time.monotonic()
            time.sleep(min(3.0, count / RATE - 5))
            busy = (used(processes) - before) / (time.monotonic() - begun)
            out, _ = sink.communicate()
        finally:
            source.kill()
    document = json.loads(out)
    latencies = sorted(document["latencies"])
    return {
        "median, ms": 1000 * statistics.median(latencies),
        "99 %, ms": 1000 * latencies[len(latencies) * 99 // 100],
        "lost": document["lost"],
        "processors, %": 100 * busy,
    }


def used(processes: list[psutil.Process]) -> float:
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--publish", type=int)
    parser.add_argument("--receive", type=int)
    parser.add_argument("--count", type=int, default=200)
    options = parser.parse_args()
    if options.publish is not None:
        return publish(options.publish)
    if options.receive is not None:
        return receive(options.receive)
    guard()
    from _tuned import tuned_environment

    own = dict(os.environ)
    for name, size in SIZES.items():
        large = {**own, "FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}
        for settings, environment in (
            ("Midstride's", tuned_environment(own)),
            ("the middleware's own", own),
            ("LARGE_DATA", tuned_environment(large)),
        ):
            figures = measure(size, options.count, environment)
            print(
                f"{name}, {settings}: " + ", ".join(f"{key} {value:.3g}" for key, value in figures.items()), flush=True
            )


if __name__ == "__main__":
    main()
