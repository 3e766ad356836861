"""Twenty plain rclpy nodes in one process: ten sensors, nine filters, and a planner behind them."""

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def ignore(_: object) -> None:
    pass


rclpy.init()
executor = SingleThreadedExecutor()
nodes = []
for number in range(10):
    sensor = Node(f"sensor{number}", namespace=f"robot{number % 3}")
    scans = sensor.create_publisher(LaserScan, "~/scan", qos_profile_sensor_data)
    sensor.create_timer(1 / (2 + number), lambda scans=scans: scans.publish(LaserScan()))
    sensor.create_subscription(String, "/mode", ignore, LATCHED)
    nodes.append(sensor)
for number in range(9):
    filter_ = Node(f"filter{number}")
    out = filter_.create_publisher(String, f"filtered{number}", 10)
    topic = f"/robot{number % 3}/sensor{number}/scan"
    filter_.create_subscription(LaserScan, topic, lambda _, out=out: out.publish(String()), qos_profile_sensor_data)
    nodes.append(filter_)
planner = Node("planner")
planner.create_publisher(String, "/mode", LATCHED).publish(String(data="go"))
for number in range(9):
    planner.create_subscription(String, f"filtered{number}", ignore, 10)
nodes.append(planner)
for node in nodes:
    executor.add_node(node)
executor.spin()
