"""One bare rclpy node of benchmarks/many.py: number NUMBER of COUNT, with the endpoints of a component of the chain.

Prints a line when the node exists, and one when its publisher and its subscription have found their peers.
"""

from __future__ import annotations

import sys

import rclpy
from std_msgs.msg import String


def main(number: int, count: int) -> None:
    rclpy.init()
    node = rclpy.create_node(f"bare{number}")
    output = node.create_publisher(String, f"/t{number + 1}", 10)
    node.create_subscription(String, f"/t{number}", output.publish, 10)
    print("created", flush=True)

    def look() -> None:
        heard = number == count - 1 or output.get_subscription_count() > 0
        if heard and (number == 0 or node.count_publishers(f"/t{number}") > 0):
            timer.cancel()
            print("matched", flush=True)

    timer = node.create_timer(0.1, look)
    rclpy.spin(node)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
