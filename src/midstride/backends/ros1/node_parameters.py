"""The author's own use of the ROS node: its parameters, and the endpoints that are not ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import rospy
from rospy.impl.registration import get_service_manager, get_topic_manager

from midstride.backends.ros1 import names
from midstride.backends.ros1.publishing import NumberedTopic
from midstride.backends.ros1.subscribing import FramedTopic
from midstride.errors import CommandRefused, MidstrideError

# What every node of rospy brings along.
_OF_ROS: Final = frozenset({"/rosout", "/clock"})
_SERVICES_OF_ROS: Final = ("/get_loggers", "/set_logger_level")


class Ros1NodeParameters:
    """Parameters of the component, shown on the parameter server under the node's name.

    The server is a place to look, not to write: what somebody else sets there changes nothing here. Only a component
    that nobody manages begins with what it finds there (a launch file's values).
    """

    def __init__(self, managed: bool, show: Callable[[str, Any], None]) -> None:
        """``show`` has the server show a value; it must not block."""
        self._managed = managed
        self._show = show
        self._values: dict[str, Any] = {}
        self._on_change: dict[str, Callable[[Any], None] | None] = {}

    def declare(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        value = default if self._managed else rospy.get_param(f"~{name}", default)
        self._values[name] = value
        self._on_change[name] = on_change
        self._show(name, value)
        return value

    def set(self, values: Mapping[str, Any]) -> None:
        """All of them or none. Raises CommandRefused."""
        if missing := [name for name in values if name not in self._values]:
            raise CommandRefused(f"there is no parameter {', '.join(missing)}")
        done: list[str] = []
        try:
            for name, value in values.items():
                self._tell(name, value)
                done.append(name)
        except Exception as error:
            for name in reversed(done):
                self._tell(name, self._values[name])
            words = str(error) if isinstance(error, MidstrideError) else f"{type(error).__name__}: {error}"
            raise CommandRefused(words) from None
        self._values.update(values)
        for name, value in values.items():
            self._show(name, value)

    def _tell(self, name: str, value: Any) -> None:
        on_change = self._on_change[name]
        if on_change is not None:
            on_change(value)

    def names(self) -> list[str]:
        return list(self._values)


def endpoints() -> list[dict[str, str]]:
    """The topics and services of this node that are neither ROS's own nor Midstride's nor ports."""
    found: set[tuple[str, str]] = set()
    manager = get_topic_manager()
    for topics, ports in ((manager.pubs, NumberedTopic), (manager.subs, FramedTopic)):
        for name, topic in list(topics.items()):
            if not isinstance(topic, ports) and name not in _OF_ROS and not names.is_ours(name):
                found.add(("topic", name))
    for name, _ in get_service_manager().get_services():
        if not name.endswith(_SERVICES_OF_ROS) and not names.is_ours(name):
            found.add(("service", name))
    return [{"kind": kind, "name": name} for kind, name in sorted(found)]
