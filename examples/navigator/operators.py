#!/usr/bin/env python3
"""Sends one goal, asks for the costmap as 20 clients do at 10 Hz each, and says what of it was answered.

It is plain rclpy and knows nothing of Midstride. The exit status is 0 if the goal succeeded with each of its waypoints
and every request was answered, exactly once.
"""

import sys
import threading
import time
from collections import Counter
from itertools import pairwise

import rclpy
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from test_msgs.action import Fibonacci

CLIENTS = 20
PERIOD = 0.1  # s between two requests of one client
PATIENCE = 10.0  # s for what was asked last
WAYPOINTS = int(sys.argv[1]) if len(sys.argv) > 1 else 50


class Operators(Node):
    def __init__(self) -> None:
        super().__init__("operators")
        self.answers: list[tuple[str, int, float]] = []
        self.delays: list[float] = []
        self.asked = 0
        self.asking = False  # until every client has found the service: a request before that is lost in ROS
        self.feedback: list[float] = []
        self.action = ActionClient(self, Fibonacci, "navigate")
        # A client's queue has the responses to all clients of the service: of ten, some fall out among 20 clients.
        deep = QoSProfile(depth=200)
        self.costmaps = [self.create_client(GetMap, "costmap", qos_profile=deep) for _ in range(CLIENTS)]
        self.pending = [False] * CLIENTS
        for number in range(CLIENTS):
            self.create_timer(PERIOD, lambda number=number: self.ask(number))

    def ask(self, number: int) -> None:
        """One request at a time for each client, as most programs do."""
        if not self.asking or self.pending[number]:
            return
        self.pending[number] = True
        self.asked += 1
        began = time.monotonic()

        def answered(future) -> None:
            self.pending[number] = False
            grid = future.result().map
            self.answers.append((grid.header.frame_id, grid.header.stamp.sec, grid.info.resolution))
            self.delays.append(time.monotonic() - began)

        self.costmaps[number].call_async(GetMap.Request()).add_done_callback(answered)

    def goal(self) -> Fibonacci.Result | None:
        """The result of a goal, or nothing if it was rejected or has none in time."""
        sent = self.action.send_goal_async(
            Fibonacci.Goal(order=WAYPOINTS), feedback_callback=lambda _: self.feedback.append(time.monotonic())
        )
        handle = wait_for(sent)
        if handle is None or not handle.accepted:
            return None
        result = wait_for(handle.get_result_async(), WAYPOINTS * 0.2 + PATIENCE)
        return result and result.result


def wait_for(future, patience: float = PATIENCE):
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    return future.result() if done.wait(patience) else None


rclpy.init()
node = Operators()
executor = SingleThreadedExecutor()
executor.add_node(node)
spinning = threading.Thread(target=executor.spin)
spinning.start()


def stop() -> None:
    executor.shutdown()
    spinning.join()
    rclpy.shutdown()


if not (node.action.wait_for_server(PATIENCE) and all(client.wait_for_service(PATIENCE) for client in node.costmaps)):
    stop()
    sys.exit("no navigator")
node.asking = True
print("asking", flush=True)
result = node.goal()
node.asking = False
end = time.monotonic() + PATIENCE
while any(node.pending) and time.monotonic() < end:
    time.sleep(0.05)
unanswered = sum(node.pending)

# A late subscriber has the latched map.
maps: list[OccupancyGrid] = []
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(OccupancyGrid, "map", maps.append, latched)
while not maps and time.monotonic() < end:
    time.sleep(0.05)

each = Counter((process, served) for process, served, _ in node.answers)
served = {process: sorted(number for other, number in each if other == process) for process, _ in each}
# Each process numbers what it executes: what it executed twice, or for somebody else, would be missing here.
once = set(each.values()) == {1} and all(numbers[-1] - numbers[0] < len(numbers) for numbers in served.values())
whole = result is not None and list(result.sequence) == list(range(1, WAYPOINTS + 1))
gaps = [later - earlier for earlier, later in pairwise(node.feedback)]
radii = sorted({round(radius, 3) for _, _, radius in node.answers})
print(
    f"goal: {'succeeded with every waypoint' if whole else 'lost'}, {len(node.feedback)} feedback messages, "
    f"longest gap {max(gaps, default=0):.2f} s"
)
print(
    f"costmap: {node.asked} requests, {unanswered} unanswered, "
    f"{'each executed once' if once else 'not each executed once'}, by {len(served)} processes, "
    f"longest {max(node.delays, default=0) * 1000:.0f} ms, inflation radius {', '.join(map(str, radii))} m"
)
print(f"map for a late subscriber: {'here' if maps else 'none'}")
stop()
sys.exit(0 if whole and once and not unanswered and maps else 1)
