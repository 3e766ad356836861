"""The endpoints of ports: publishers and subscriptions of rclpy, their QoS, and what the middleware reports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription as RclpySubscription

from midstride.backends.common import comes_true
from midstride.backends.ros2.middleware import RmwImplementation, identity_of
from midstride.model.contract import QoS

# Where rclpy can hand message information to a callback at all (not on humble).
HAS_INFO: Final = hasattr(RclpySubscription, "CallbackType")
# From here on a duration means that there is none (ns): each middleware has a number for it, of 68 years or more.
_INFINITE: Final = 10**18


def serialized(message_type: type) -> type:
    """The class of messages of ``message_type`` that are not deserialised: bytes, as the middleware has them."""
    return type(f"Serialized{message_type.__name__}", (bytes,), {"message_type": message_type})


def message_type_of(type_: type) -> tuple[type, bool]:
    """The message type of a port of ``type_``, and whether its messages stay serialised."""
    return (type_.__dict__["message_type"], True) if issubclass(type_, bytes) else (type_, False)


def profile_of(qos: QoS) -> Any:
    """The profile of a real endpoint: what is not stated is ROS 2's default (semantics.md section 1)."""
    stated = qos.effective()
    result = QoSProfile(
        history=HistoryPolicy.KEEP_ALL if stated.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        depth=stated.depth,
        reliability=ReliabilityPolicy.RELIABLE if stated.is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if stated.is_transient_local else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC
        if stated.liveliness == "manual_by_topic"
        else LivelinessPolicy.AUTOMATIC,
    )
    if stated.deadline is not None:
        result.deadline = Duration(nanoseconds=round(stated.deadline * 1e9))
    if stated.lease is not None:
        result.liveliness_lease_duration = Duration(nanoseconds=round(stated.lease * 1e9))
    if stated.lifespan is not None:
        result.lifespan = Duration(nanoseconds=round(stated.lifespan * 1e9))
    return result


def qos_of(profile: Any) -> QoS:
    """The QoS of a real endpoint in the graph, as far as it is compared (semantics.md section 1)."""
    return QoS(
        reliability="best_effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        liveliness="manual_by_topic" if profile.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC else "automatic",
        deadline=seconds_of(profile.deadline),
        lease=seconds_of(profile.liveliness_lease_duration),
    )


def seconds_of(duration: Any) -> float | None:
    """A duration of a profile (s); None where there is none."""
    return duration.nanoseconds / 1e9 if 0 < duration.nanoseconds < _INFINITE else None


class RosPublisher:
    """An output's publisher. ``publish`` is rclpy's own method: a message costs nothing on the way."""

    __slots__ = ("_acknowledged", "_destroy", "_in_graph", "_publisher", "_rmw", "publish")

    def __init__(
        self,
        publisher: Any,
        qos: QoS,
        rmw: RmwImplementation,
        destroy: Callable[[Any], object],
        in_graph: Callable[[str], list[Any]],
    ) -> None:
        """``in_graph`` lists the subscriptions of a topic."""
        self._publisher = publisher
        self._rmw = rmw
        self._in_graph = in_graph
        self._acknowledged = qos.is_reliable and rmw.acknowledges
        self._destroy = destroy
        self.publish: Callable[[Any], None] = publisher.publish

    def matched(self) -> int:
        """The middleware's own count of matched readers: incompatible ones are not among them, as in the graph."""
        try:
            return int(self._publisher.get_subscription_count())
        except InvalidHandle:
            return 0

    def reader_ids(self) -> frozenset[str]:
        if not self._rmw.shares_identities:
            return frozenset()
        try:
            return frozenset(identity_of(info) for info in self._in_graph(self._publisher.topic_name))
        except InvalidHandle:
            return frozenset()

    async def acknowledged(self, timeout: float) -> bool | None:
        """True as soon as it is so; None where that does not show in time, or cannot be known.

        rclpy's own wait holds the interpreter's lock for as long as it lasts, so it is asked again and again.
        """
        if not self._acknowledged:
            return None
        at_once = Duration(nanoseconds=0)
        try:
            return await comes_true(lambda: self._publisher.wait_for_all_acked(at_once), timeout) or None
        except InvalidHandle:
            return None

    def destroy(self) -> None:
        self._destroy(self._publisher)


class RosSubscription:
    """An input's subscription."""

    __slots__ = ("_destroy", "_in_graph", "_rmw", "_subscription")

    def __init__(
        self,
        subscription: Any,
        rmw: RmwImplementation,
        destroy: Callable[[Any], object],
        in_graph: Callable[[str], list[Any]],
    ) -> None:
        """``in_graph`` lists the publishers of a topic."""
        self._subscription = subscription
        self._rmw = rmw
        self._destroy = destroy
        self._in_graph = in_graph

    def matched(self) -> int:
        handle = self._subscription.handle
        try:
            with handle:
                if hasattr(handle, "get_publisher_count"):
                    return int(handle.get_publisher_count())
            return len(self._in_graph(self._subscription.topic_name))  # that rclpy counts none (humble)
        except InvalidHandle:
            return 0

    def publisher_ids(self) -> frozenset[str] | None:
        if not self._rmw.shares_identities:
            return None
        try:
            return frozenset(identity_of(info) for info in self._in_graph(self._subscription.topic_name))
        except InvalidHandle:
            return frozenset()

    def destroy(self) -> None:
        self._destroy(self._subscription)


def for_rclpy(callback: Callable[[Any, Any], None]) -> Callable[..., None]:
    """The callback as rclpy takes it: with two arguments it is handed the message's information."""
    if HAS_INFO:
        return callback
    return lambda message: callback(message, None)
