"""What the lifecycle nodes of this example share, as those of Nav2 do: a bond with the manager while they are active.

Nav2's bonds are messages of `bond/msg/Status`, which no wheel has. Here the same words are in a string.
"""

import uuid
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String


class NavNode(LifecycleNode):
    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.bond = None
        self.heartbeat = None
        self.instance = uuid.uuid4().hex  # another one for each process

    def on_activate(self, state) -> TransitionCallbackReturn:
        self.bond = self.create_publisher(String, "bond", 5)
        self.heartbeat = self.create_timer(self.declared("bond_heartbeat_period", 0.25), lambda: self.beat(True))
        return super().on_activate(state)

    def on_deactivate(self, state) -> TransitionCallbackReturn:
        self.beat(False)
        self.destroy_timer(self.heartbeat)
        self.destroy_publisher(self.bond)
        return super().on_deactivate(state)

    def beat(self, active: bool) -> None:
        self.bond.publish(String(data=f"{self.get_name()} {self.instance} {'active' if active else 'gone'}"))

    def declared(self, name: str, value: float) -> float:
        return self.get_parameter(name).value if self.has_parameter(name) else self.declare_parameter(name, value).value


def run(node_class: type) -> None:
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node_class())
