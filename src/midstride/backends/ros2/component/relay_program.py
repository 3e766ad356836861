"""The process of a relay on ROS 2 (:mod:`midstride.foreign.relay`); its argument is the file of its order."""

from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.serialization import deserialize_message

from midstride.backends.common_messages import message_class
from midstride.backends.ros2.component.host import Ros2Host
from midstride.backends.ros2.component.port_endpoints import serialized
from midstride.backends.ros2.manager.graph import Graph
from midstride.backends.ros2.manager.node_services import RosNodeServices
from midstride.foreign.relay import RelayPlatform, run_relay
from midstride.foreign.relayed_program import RelayOrder


class _NotExecuted(CallbackGroup):  # type: ignore[misc]
    """Keeps an executor away from what is in it."""

    def can_execute(self, entity: Any) -> bool:
        return False


def parameters(host: Any, order: RelayOrder) -> RosNodeServices:
    services = RosNodeServices(host.ros_node, order.node, _NotExecuted())
    host.leave_out(services.connect())
    return services


PLATFORM = RelayPlatform(
    host=lambda context: Ros2Host(context.instance or "", context.namespace),
    type_of=lambda name: serialized(message_class(name)),
    decoder=lambda name: partial(deserialize_message, message_type=message_class(name)),
    graph=lambda host, order: Graph(host.ros_node).of_process(order.node) or None,
    parameters=parameters,
    nodes=lambda host, enclave: Graph(host.ros_node).of_enclave(enclave),
)

if __name__ == "__main__":
    run_relay(PLATFORM)
