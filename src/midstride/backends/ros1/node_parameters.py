"""The author's use of the ROS node: its parameters, and the endpoints that are not ports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import rospy
from rospy.impl.registration import get_service_manager, get_topic_manager

from midstride.backends.common import KeptParameters
from midstride.backends.ros1 import names
from midstride.backends.ros1.publishing import NumberedTopic
from midstride.backends.ros1.subscribing import FramedTopic
from midstride.wire.state import Endpoint

# Endpoints of every node of rospy.
_TOPICS_OF_ROS: Final = frozenset({*names.INTERNAL, "/clock"})
_SERVICES_OF_ROS: Final = ("/get_loggers", "/set_logger_level")


class Ros1NodeParameters(KeptParameters):
    """Parameters of the component, shown on the parameter server under the node's name.

    They are shown to be read: setting them there changes nothing here. Only a component that no manager started begins
    with the values that it finds there (a launch file's).
    """

    def __init__(self, managed: bool, show: Callable[[str, Any], None]) -> None:
        """``show`` sets a value on the parameter server; it must not block."""
        super().__init__(show)
        self._managed = managed

    def declare(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        return super().declare(name, default if self._managed else rospy.get_param(f"~{name}", default), on_change)


def endpoints() -> list[Endpoint]:
    """The topics and services of this node that are neither ports nor of ROS or Midstride."""
    found: list[Endpoint] = []
    manager = get_topic_manager()
    for topics, ports in ((manager.pubs, NumberedTopic), (manager.subs, FramedTopic)):
        for name, topic in list(topics.items()):
            endpoint = Endpoint(kind="topic", name=name)
            if not isinstance(topic, ports) and name not in _TOPICS_OF_ROS and endpoint not in found:
                found.append(endpoint)
    for name, _ in get_service_manager().get_services():
        if not name.endswith(_SERVICES_OF_ROS):
            found.append(Endpoint(kind="service", name=name, serves=True))
    return sorted(found, key=lambda endpoint: (endpoint.kind, endpoint.name))
