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
from midstride.foreign.foreign_state import EXPORT_STATE, IMPORT_STATE, OfferedState
from midstride.foreign.graph_check import NamedServer, Served
from midstride.foreign.relay import RelayPlatform, run_relay
from midstride.foreign.relayed_program import RelayOrder


class _NotExecuted(CallbackGroup):  # type: ignore[misc]
    """Keeps an executor away from what is in it."""

    def can_execute(self, entity: Any) -> bool:
        return False


def services(host: Any, node: str, *names: str) -> RosNodeServices:
    made = RosNodeServices(host.ros_node, node, _NotExecuted())
    for client in made.connect(*names):
        host.leave_out(client)
    return made


def offered_state(host: Any, order: RelayOrder) -> OfferedState:
    """The state of the program's node.

    Its servers are those that clients have found: by node, the graph may list those of an earlier one of that name.
    """
    both = EXPORT_STATE, IMPORT_STATE
    own = services(host, order.node, *(name for name, _ in both))

    def served() -> Served:
        found = (NamedServer("service", f"{order.node}/{name}", type_) for name, type_ in both if own.is_ready(name))
        return Served(servers=frozenset(found))

    return OfferedState(host.instance, lambda: order.node, own, served)


PLATFORM = RelayPlatform(
    host=lambda context: Ros2Host(context.instance or "", context.namespace),
    type_of=lambda name: serialized(message_class(name)),
    decoder=lambda name: partial(deserialize_message, message_type=message_class(name)),
    graph=lambda host, order: Graph(host.ros_node).of_process(order.node) or None,
    service_type=message_class,
    parameters=lambda host, order: services(host, order.node, *PARAMETERS, "set_parameters_atomically"),
    state=offered_state,
    nodes=lambda host, enclave: Graph(host.ros_node).of_enclave(enclave),
    served=lambda host, node: Graph(host.ros_node).served_by(node),
    # What has a client of `change_state` is taken for a lifecycle manager.
    services=lambda host, node, changes: services(host, node, *LIFECYCLE[: 1 + changes], *PARAMETERS),
)

if __name__ == "__main__":
    run_relay(PLATFORM)
