"""The manager's subscriptions of topics on ROS 2, which are read when they are asked for: its node is not spun."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.exceptions import InvalidHandle

from midstride.backends.common_messages import message_class
from midstride.backends.last_message import EVERY, KEPT, LastMessage
from midstride.backends.ros2 import middleware
from midstride.backends.ros2.component.port_endpoints import profile_of
from midstride.backends.ros2.manager.graph import Graph
from midstride.backends.ros2.manager.publisher_processes import PublisherProcesses
from midstride.backends.ros2.middleware import identity_of
from midstride.errors import BackendError, NodeError
from midstride.model.contract import Predicate, QoS
from midstride.runtime.backend_protocol import HeardMessage


class RosListener:
    """Listens to ``topic`` by the manager's ``node``. To be used on one thread; ``now`` is the steady clock (s).

    Each subscription keeps the last message alone. A middleware that does not name the publisher of a message is asked
    which publishers there are: if one of them is gone, the message may have been its own. Raises BackendError where
    the message type is not installed.
    """

    def __init__(
        self,
        node: Any,
        graph: Graph,
        topic: str,
        assumption: Predicate,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        try:
            self._message_type = message_class(assumption.type)
        except NodeError as error:
            raise BackendError(str(error)) from None
        self._node, self._graph, self._topic, self._type, self._now = node, graph, topic, assumption.type, now
        self._rmw = middleware.of_this_process()
        self._last = LastMessage(assumption)
        self._processes = PublisherProcesses(graph)
        self._every, self._kept = self._subscription(EVERY), self._subscription(KEPT)
        self._publishers: frozenset[str] = frozenset()
        self._asked = now()

    def _subscription(self, qos: QoS) -> Any:
        return self._node.create_subscription(self._message_type, self._topic, lambda _: None, profile_of(qos))

    def heard(self) -> HeardMessage:
        try:
            return self._heard()
        except RuntimeError as error:  # the base of rclpy's own kinds
            return HeardMessage(problem=f"the middleware cannot be asked: {error}")

    def _heard(self) -> HeardMessage:
        infos = self._processes.living(self._graph.living_publishers(self._topic))
        if others := sorted({info.topic_type for info in infos} - {self._type}):
            return HeardMessage(publishers=len(infos), problem=f"{', '.join(others)} is published there")
        self._take(self._kept, kept=True)
        self._take(self._every, kept=False)
        self._asked = self._now()
        publishers = frozenset(identity_of(info) for info in infos)
        if self._last.may_be_gone(publishers, self._publishers):
            self._last.forget()
            self._node.destroy_subscription(self._kept)
            self._kept = self._subscription(KEPT)  # what the others have kept
        self._publishers = publishers
        return self._last.heard(len(infos))

    def _take(self, subscription: Any, *, kept: bool) -> None:
        try:
            with subscription.handle:
                taken = subscription.handle.take_message(self._message_type, False)
        except InvalidHandle:
            return
        if taken is None:
            return
        message, info = taken
        facts = self._rmw.message_info(info)
        received = (info or {}).get("received_timestamp") or 0
        # Where the middleware does not say when it arrived, it was after the last look.
        at = self._now() - max(0.0, (time.time_ns() - received) / 1e9) if received else self._asked
        self._last.received(message, max(at, self._asked), facts.source, facts.publisher, kept=kept)

    def close(self) -> None:
        for subscription in (self._every, self._kept):
            self._node.destroy_subscription(subscription)
