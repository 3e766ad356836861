"""The author's own use of the ROS node: its parameters, and the endpoints that are not ports."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Final, Literal, TypeAlias

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.parameter import Parameter

from midstride.backends.ros2.component.data_node import NodeParameter
from midstride.backends.ros2.middleware import RmwImplementation
from midstride.backends.ros2.names import PARAMETER_EVENTS, service_name
from midstride.errors import CommandRefused, NodeError
from midstride.model.instance_names import PRIVATE_NAMES, full_name
from midstride.node.legible import legible
from midstride.wire.state import Endpoint

Kind: TypeAlias = Literal["topic", "service", "ROS action"]

# What every node of rclpy has.
_OF_ROS: Final = frozenset({"/parameter_events", "/rosout", "/clock"})
_SERVICES_OF_ROS: Final = ("/get_type_description",)
# The topic that each end of a ROS action has.
_ACTION_STATUS: Final = "/_action/status"


class Ros2NodeParameters:
    """Parameters of the data node, declared and set on the data side."""

    def __init__(self, node: Any, given: Collection[str]) -> None:
        """``given``: the names that the manager gives values for; such a value comes as the default here."""
        self._node = node
        self._given = given
        self._on_change: dict[str, Callable[[Any], None]] = {}

    def declare(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        """Raises NodeError where ROS 2 takes no such parameter."""
        try:
            if self._node.has_parameter(name):  # by the author's set-up, or by ROS itself
                value = self._node.get_parameter(name).value
            else:
                value = self._node.declare_parameter(name, default, ignore_override=name in self._given).value
        except ParameterException as error:
            raise NodeError(f"parameter {name}: {error}") from error
        if on_change is not None:
            if not self._on_change:
                self._node.add_on_set_parameters_callback(self._changing)
            self._on_change[name] = on_change
        return value

    def held(self) -> Mapping[str, NodeParameter]:
        return self._node.held()  # type: ignore[no-any-return]

    def on_changed(self, changed: Callable[[], object]) -> None:
        self._node.changed = changed

    def set(self, values: dict[str, Any]) -> None:
        """All of them or none. Raises CommandRefused."""
        missing = [name for name in values if not self._node.has_parameter(name)]
        if missing:
            raise CommandRefused(f"there is no parameter {', '.join(missing)}")
        try:
            parameters = [self._parameter(name, value) for name, value in values.items()]
        except (TypeError, ValueError) as error:
            raise CommandRefused(f"not a value of a parameter: {error}") from None
        result = self._node.set_from_outside(parameters)
        if not result.successful:
            raise CommandRefused(result.reason or "the node refuses it without a reason")

    def _parameter(self, name: str, value: Any) -> Any:
        """JSON knows no difference between 1 and 1.0; ROS 2 does."""
        kind = self._node.get_parameter(name).type_
        if kind == Parameter.Type.DOUBLE and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        elif kind == Parameter.Type.DOUBLE_ARRAY and isinstance(value, list):
            value = [float(member) for member in value]
        return Parameter(name, kind if value == [] else None, value)

    def _changing(self, parameters: list[Any]) -> Any:
        """Call the author's functions: if one raises, the whole set is refused; those called before get the old
        values again.
        """
        called: list[tuple[Callable[[Any], None], Any]] = []
        for parameter in parameters:
            on_change = self._on_change.get(parameter.name)
            if on_change is None:
                continue
            before = self._node.get_parameter(parameter.name).value
            try:
                on_change(parameter.value)
            except Exception as error:
                for undo, old in reversed(called):
                    undo(old)
                return SetParametersResult(successful=False, reason=legible(f"{parameter.name}: {error}"))
            called.append((on_change, before))
        return SetParametersResult(successful=True)


def endpoints(node: Any, control: str, ports: Collection[int], rmw: RmwImplementation) -> list[Endpoint]:
    """The topics, services and ROS actions of ``node`` that are neither ROS's own nor in ``ports`` (by ``id``).

    ``control`` is the full name of the node beside it.
    """
    found: dict[tuple[Kind, str], bool | None] = {}
    for topic in (*node.publishers, *node.subscriptions):
        if id(topic) not in ports and topic.topic_name not in _OF_ROS:
            found["topic", topic.topic_name] = None
    for serves, services in ((False, node.clients), (True, node.services)):  # a node that does both serves it
        for service in services:
            name = service_name(node, service)
            if id(service) not in ports and not name.endswith(_SERVICES_OF_ROS):
                found["service", name] = serves
    for name, serves in _actions(node, control, rmw):
        found["ROS action", name] = serves or bool(found.get(("ROS action", name)))
    return [Endpoint(kind=kind, name=name, serves=serves) for (kind, name), serves in sorted(found.items())]


def _actions(node: Any, control: str, rmw: RmwImplementation) -> Iterator[tuple[str, bool]]:
    """The ROS actions of this process, each with whether it serves or calls it.

    The graph knows them, for rclpy keeps no list. One's own ends are in it at once. Another node may have the same
    name, so they are recognized by the process; where that is unknown, by the name if no other node has it.
    """
    topics = (topic for topic, _ in node.get_topic_names_and_types())
    # A relay is the client of its program under a private name.
    status_topics = [
        topic for topic in topics if topic.endswith(_ACTION_STATUS) and not topic.startswith(PRIVATE_NAMES)
    ]
    if not status_topics:
        return  # every node is among the publishers of the next line
    own: set[bytes | str | None] = {
        rmw.process_of(info)
        for info in node.get_publishers_info_by_topic(PARAMETER_EVENTS)
        if full_name(info.node_name, info.node_namespace) == control
    }
    if rmw.participant is None:
        name = node.get_name(), node.get_namespace()
        own = {full_name(*name)} if node.get_node_names_and_namespaces().count(name) == 1 else set()
    for topic in status_topics:
        servers, clients = node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic)
        for serves, ends in ((True, servers), (False, clients)):
            if any((rmw.process_of(info) or full_name(info.node_name, info.node_namespace)) in own for info in ends):
                yield topic.removesuffix(_ACTION_STATUS), serves
