"""The nodes of benchmarks/reflex.py: a publisher with faults on request, components that rely on it, and bare rclpy.

``source FOLDER`` and ``stage FOLDER`` are components. ``speaker FOLDER`` and ``reader FOLDER`` are bare nodes: a
publisher with the same faults and a heartbeat, and a subscriber with the three usual remedies.

The publishers write at 50 Hz, or at MIDSTRIDE_REFLEX_RATE. While the file ``hung`` is in the folder their call does not
return, while ``slow`` is they write every fifth message, and when ``crashed`` is they kill themselves. What notices it
appends the time (steady ns) to a file of its name: ``b.fell``, ``deadline.fell``.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

RATE = float(os.environ.get("MIDSTRIDE_REFLEX_RATE", "50"))
# What Nav2's bond waits for; its heartbeats come four times per second.
BOND_TIMEOUT, BOND_PERIOD = 4.0, 0.25
# The others wait as long as the reflex: the silence that it tolerates (s).
TOLERATED = float(os.environ.get("MIDSTRIDE_REFLEX_TOLERATED", "1"))


def faulty(folder: Path, write: Callable[[], object]) -> Callable[[], None]:
    """A mode function that calls ``write``, with the faults that the folder asks for."""
    calls = 0

    def call() -> None:
        nonlocal calls
        calls += 1
        if (folder / "crashed").exists():
            (folder / "crashed").unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        while (folder / "hung").exists():
            time.sleep(0.01)
        if calls % 5 == 0 or not (folder / "slow").exists():
            write()

    return call


def fell(folder: Path, name: str) -> None:
    with (folder / f"{name}.fell").open("a") as file:
        file.write(f"{time.monotonic_ns()}\n")


# -- components --------------------------------------------------------------------------------------------


def source(folder: Path) -> None:
    from std_msgs.msg import String

    from midstride import Component

    comp = Component("source")
    out = comp.create_output("out", String)
    work = comp.create_functionality("work", outputs=[out])
    work.set_normal_mode(faulty(folder, lambda: out.write(String(data="x"))), rate=RATE, outputs=[out])
    work.set_degraded_mode(lambda: None)
    comp.start()


def stage(folder: Path) -> None:
    """Writes at a fixed rate while its assumption holds."""
    from std_msgs.msg import String

    from midstride import Component

    comp = Component("stage")
    inlet, out = comp.create_input("in", String, rate=RATE), comp.create_output("out", String)
    work = comp.create_functionality("work", inputs=[inlet], outputs=[out])
    work.set_normal_mode(lambda: out.write(String(data="x")), rate=RATE, inputs=[inlet], outputs=[out])
    work.set_degraded_mode(lambda: fell(folder, comp.instance))
    comp.start()


# -- bare nodes --------------------------------------------------------------------------------------------


def _spin(node: Any) -> None:
    import rclpy
    from rclpy.executors import ExternalShutdownException

    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


def _profile() -> Any:
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile

    return QoSProfile(depth=10, deadline=Duration(seconds=TOLERATED))


def speaker(folder: Path) -> None:
    """Its heartbeat is a timer of the same executor, as in most nodes."""
    import rclpy
    from std_msgs.msg import Empty, String

    rclpy.init()
    node = rclpy.create_node("speaker")
    out, alive = node.create_publisher(String, "/bare", _profile()), node.create_publisher(Empty, "/bond", 10)
    node.create_timer(1 / RATE, faulty(folder, lambda: out.publish(String(data="x"))))
    node.create_timer(BOND_PERIOD, lambda: alive.publish(Empty()))
    _spin(node)


class Watchdog:
    """Falls once when nothing has come for so long, and is armed again by the next message."""

    def __init__(self, folder: Path, name: str, seconds: float) -> None:
        self.folder, self.name, self.seconds = folder, name, seconds
        self.last: float | None = None

    def feed(self, _: object) -> None:
        self.last = time.monotonic()

    def look(self) -> None:
        if self.last is not None and time.monotonic() - self.last > self.seconds:
            self.last = None
            fell(self.folder, self.name)


def reader(folder: Path) -> None:
    import rclpy
    from rclpy.event_handler import SubscriptionEventCallbacks
    from std_msgs.msg import Empty, String

    rclpy.init()
    node = rclpy.create_node("reader")
    bond, watchdog = Watchdog(folder, "bond", BOND_TIMEOUT), Watchdog(folder, "watchdog", TOLERATED)
    node.create_subscription(Empty, "/bond", bond.feed, 10)
    node.create_subscription(
        String,
        "/bare",
        watchdog.feed,
        _profile(),
        event_callbacks=SubscriptionEventCallbacks(deadline=lambda _: fell(folder, "deadline")),
    )
    node.create_timer(0.1, bond.look)
    node.create_timer(0.1, watchdog.look)
    _spin(node)


if __name__ == "__main__":
    {"source": source, "stage": stage, "speaker": speaker, "reader": reader}[sys.argv[1]](Path(sys.argv[2]))
