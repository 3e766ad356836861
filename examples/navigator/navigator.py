#!/usr/bin/env python3
"""Drives to waypoints: an action server, a costmap service, a latched map and a parameter, in plain rclpy.

The wheels of ROS 2 have no nav2_msgs, so the action is `test_msgs/action/Fibonacci`: its order is the number of
waypoints, its feedback and result are those that were reached.
"""

import os
import time
from contextlib import suppress

import rclpy
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from test_msgs.action import Fibonacci

PERIOD = 0.2  # s from waypoint to waypoint, so feedback has 5 Hz


class Navigator(Node):
    def __init__(self) -> None:
        super().__init__("navigator")
        self.declare_parameter("inflation_radius", 0.3)
        self.served = 0
        self.map = self.create_publisher(
            OccupancyGrid, "map", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        )
        grid = OccupancyGrid()
        grid.info.width, grid.info.height, grid.info.resolution = 20, 10, 0.5
        grid.data = [0] * 200
        self.map.publish(grid)
        self.create_service(GetMap, "costmap", self.costmap)
        self.actions = ActionServer(
            self,
            Fibonacci,
            "navigate",
            self.drive,
            callback_group=ReentrantCallbackGroup(),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def costmap(self, request: GetMap.Request, response: GetMap.Response) -> GetMap.Response:
        """Says which process answers, for which time, and with which radius."""
        self.served += 1
        response.map.header.frame_id = str(os.getpid())
        response.map.header.stamp.sec = self.served
        response.map.info.resolution = float(self.get_parameter("inflation_radius").value)
        return response

    def drive(self, goal) -> Fibonacci.Result:
        reached = Fibonacci.Feedback()
        for waypoint in range(1, goal.request.order + 1):
            time.sleep(PERIOD)
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=reached.sequence)
            reached.sequence.append(waypoint)
            goal.publish_feedback(reached)
        goal.succeed()
        return Fibonacci.Result(sequence=reached.sequence)


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Navigator(), MultiThreadedExecutor(4))
