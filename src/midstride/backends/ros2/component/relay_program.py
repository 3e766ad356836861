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
from midstride.backends.ros2.manager.node_services import LIFECYCLE, PARAMETERS, RosNodeServices
from midstride.foreign.relay import RelayPlatform, run_relay


class _NotExecuted(CallbackGroup):  # type: ignore[misc]
    """Keeps an executor away from what is in it."""

    def can_execute(self, entity: Any) -> bool:
        return False


def services(host: Any, node: str, *names: str) -> RosNodeServices:
    made = RosNodeServices(host.ros_node, node, _NotExecuted())
    for client in made.connect(*names):
        host.leave_out(client)
    return made


PLATFORM = RelayPlatform(
    host=lambda context: Ros2Host(context.instance or "", context.namespace),
    type_of=lambda name: serialized(message_class(name)),
    decoder=lambda name: partial(deserialize_message, message_type=message_class(name)),
    graph=lambda host, order: Graph(host.ros_node).of_process(order.node) or None,
    parameters=lambda host, order: services(host, order.node, *PARAMETERS, "set_parameters_atomically"),
    nodes=lambda host, enclave: Graph(host.ros_node).of_enclave(enclave),
    served=lambda host, node: Graph(host.ros_node).served_by(node),
    # What has a client of `change_state` is taken for a lifecycle manager.
    services=lambda host, node, changes: services(host, node, *LIFECYCLE[: 1 + changes], *PARAMETERS),
)

if __name__ == "__main__":
    run_relay(PLATFORM)
