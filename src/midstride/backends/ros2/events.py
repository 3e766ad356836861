"""Parameter events: the change stream of components, as every ROS tool reads it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameter_events

TOPIC = "/parameter_events"


def publisher(node: Any) -> Any:
    return node.create_publisher(ParameterEvent, TOPIC, qos_profile_parameter_events)


def subscription(node: Any, callback: Any, group: Any) -> Any:
    return node.create_subscription(ParameterEvent, TOPIC, callback, qos_profile_parameter_events, callback_group=group)


def changed(node: str, stamp: int, values: Mapping[str, Any]) -> Any:
    """The event that parameters of ``node`` have these values now."""
    event = ParameterEvent(node=node)
    event.stamp.sec, event.stamp.nanosec = divmod(stamp, 1_000_000_000)
    event.changed_parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    return event
