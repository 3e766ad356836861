"""The driver of the depth camera as a lifecycle node of ROS 2, which does not use Midstride's API."""

import contextlib

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from sensor_msgs.msg import Image


class LifecycleCamera(LifecycleNode):
    def __init__(self) -> None:
        super().__init__("camera")

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        self.publisher = self.create_lifecycle_publisher(Image, "image_raw", 10)
        self.create_subscription(Image, "device", self.publisher.publish, 10)
        return TransitionCallbackReturn.SUCCESS


rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(LifecycleCamera())
