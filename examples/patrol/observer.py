"""A node in plain rclpy, which knows nothing of Midstride: does the robot drive on what it saw long ago?

It writes ``observed.json`` (the parameter ``file``) every second: for how long at most the robot moved although the
scan behind the newest obstacles was older than half a second, and the longest time between two commands (s).
"""

import contextlib
import json
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

STALE = 0.5


class Observer(Node):
    def __init__(self) -> None:
        super().__init__("observer")
        self.file = Path(self.declare_parameter("file", "observed.json").value)
        self.seen = {"moved_blind": 0.0, "without_commands": 0.0, "commands": 0, "moved": 0.0}
        self.scanned = self.commanded = self.began = None
        self.create_subscription(LaserScan, "near", self.on_obstacles, 10)
        self.create_subscription(Twist, "cmd", self.on_command, 10)
        self.create_subscription(Odometry, "wheels", self.on_wheels, 10)
        self.create_timer(1.0, lambda: self.file.write_text(json.dumps(self.seen)))

    def now(self) -> float:
        return self.get_clock().now().nanoseconds / 1e9

    @staticmethod
    def stamped(message: LaserScan | Odometry) -> float:
        """When it was measured (s), however late it is read here: a busy machine delays both kinds alike."""
        return message.header.stamp.sec + message.header.stamp.nanosec / 1e9

    def on_obstacles(self, message: LaserScan) -> None:
        self.scanned = self.stamped(message)

    def on_command(self, message: Twist) -> None:
        now = self.now()
        if self.commanded is not None:
            self.longest("without_commands", now - self.commanded)
        self.commanded = now
        self.seen["commands"] += 1

    def on_wheels(self, message: Odometry) -> None:
        measured, speed = self.stamped(message), abs(message.twist.twist.linear.x)
        self.longest("moved", speed)
        if speed < 0.05 or self.scanned is None or measured - self.scanned < STALE:
            self.began = None
            return
        self.began = self.began or measured
        self.longest("moved_blind", measured - self.began)

    def longest(self, name: str, seconds: float) -> None:
        self.seen[name] = max(self.seen[name], seconds)


rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Observer())
