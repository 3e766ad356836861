"""Records topics of ROS 2 in a bag, until SIGINT: ``python3 recorder.py BAG TOPIC:PACKAGE/TYPE…``.

A node in plain rclpy, which knows nothing of Midstride. Beside each message, ``/recorder/info`` has who wrote it, which
of that writer's messages it is (from 1), and when it was sent (unix ns), as the middleware reports them. rclpy of Jazzy
does not say who wrote it: null.
"""

import contextlib
import importlib
import json
import sys
from functools import partial

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import String

INFO = "/recorder/info"


class Recorder(Node):
    def __init__(self, bag: Writer, topics: list[str]) -> None:
        super().__init__("recorder")
        self.bag, store = bag, get_typestore(Stores.ROS2_JAZZY)
        self.info = bag.add_connection(INFO, "std_msgs/msg/String", typestore=store)
        for each in topics:
            topic, _, name = each.partition(":")
            package, _, type_ = name.partition("/")
            connection = bag.add_connection(topic, f"{package}/msg/{type_}", typestore=store)
            message = getattr(importlib.import_module(f"{package}.msg"), type_)
            self.create_subscription(message, topic, partial(self.on_message, topic, connection), 100, raw=True)

    def on_message(self, topic: str, connection, data: bytes, info: dict) -> None:
        received = info["received_timestamp"]
        self.bag.write(connection, received, data)
        writer = info.get("publisher_gid")
        words = {
            "topic": topic,
            "writer": None if writer is None else writer["data"].hex(),
            "number": info["publication_sequence_number"],
            "sent": info["source_timestamp"],
        }
        self.bag.write(self.info, received, serialize_message(String(data=json.dumps(words))))


with Writer(sys.argv[1], version=9) as bag, contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.init()
    rclpy.spin(Recorder(bag, sys.argv[2:]))
