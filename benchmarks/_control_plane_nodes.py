"""The components that benchmarks/control_plane.py runs, on ROS 2 and on ROS 1.

A component appends the moment at which its imports are done to the file named by BENCHMARK_IMPORTS (steady ns).
"""

from __future__ import annotations

import importlib
import os
import sys
import time

from std_msgs.msg import String

from midstride import Component

RATE = 50.0
# Imported by the first component of a process.
HOSTS = {"ros2": "midstride.backends.ros2.component.host", "ros1": "midstride.backends.ros1.host"}


def source() -> None:
    """Writes at 50 Hz."""
    component = Component("source")
    out = component.create_output("out", String)
    talk = component.create_functionality("talk", outputs=[out])
    talk.set_normal_mode(lambda: out.write(String(data="tick")), rate=RATE, outputs=[out])
    talk.set_degraded_mode(lambda: None)
    component.start()


def sink() -> None:
    """Relies on what the source writes."""
    component = Component("sink")
    heard = component.create_input("in", String, rate=RATE)
    listen = component.create_functionality("listen", inputs=[heard])
    listen.set_normal_mode(lambda message: None, inputs=[heard])
    listen.set_degraded_mode(lambda: None)
    component.start()


def head() -> None:
    """Could write, and never does."""
    component = Component("head")
    out = component.create_output("out", String)
    work = component.create_functionality("work", outputs=[out])
    work.set_normal_mode(lambda: None, outputs=[out])
    work.set_degraded_mode(lambda: None)
    component.start()


def link() -> None:
    """Waits for messages that never come, to pass them on."""
    component = Component("link")
    heard = component.create_input("in", String)
    out = component.create_output("out", String)
    work = component.create_functionality("work", inputs=[heard], outputs=[out])
    work.set_normal_mode(lambda message: out.write(message), inputs=[heard], outputs=[out])
    work.set_degraded_mode(lambda: None)
    component.start()


def bare(number: str) -> None:
    """What ``link`` has of ROS, without Midstride."""
    topics = f"/t{number}", f"/t{int(number) + 1}"
    if os.environ["MIDSTRIDE_BACKEND"] == "ros2":
        import rclpy

        rclpy.init()
        node = rclpy.create_node(f"bare{number}")
        output = node.create_publisher(String, topics[1], 10)
        node.create_subscription(String, topics[0], output.publish, 10)
        rclpy.spin(node)
    else:
        import rospy

        rospy.init_node(f"bare{number}")
        written = rospy.Publisher(topics[1], String, queue_size=10)
        rospy.Subscriber(topics[0], String, written.publish)
        rospy.spin()


if __name__ == "__main__":
    if path := os.environ.get("BENCHMARK_IMPORTS"):
        importlib.import_module(HOSTS[os.environ["MIDSTRIDE_BACKEND"]])
        with open(path, "a", encoding="ascii") as file:
            file.write(f"{time.monotonic_ns()}\n")
    if sys.argv[1] == "bare":
        bare(sys.argv[2])
    else:
        {"source": source, "sink": sink, "head": head, "link": link}[sys.argv[1]]()
