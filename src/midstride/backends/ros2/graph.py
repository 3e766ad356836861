"""The graph as the manager's node sees it, without what the manager knows to be dead.

A process that was killed stays in the graph until its lease runs out. Its exit is known at once, so everything under
its name is ignored from then on. Once another process of that name is about to start, what the graph shows under the
name is remembered by endpoint instead. A node that this manager did not start is alive as long as it has an endpoint:
every node has one, and the graph may keep the name of one that is gone, for good.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Final

from midstride.backends.ros2 import names
from midstride.runtime.backend import Endpoints

# For how long a dead process may stay in the graph (s): the lease of the middleware, and some time to notice.
LINGER: Final = 25.0


class Graph:
    """To be used on one thread. ``node`` is rclpy's."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._died: dict[str, float] = {}
        self._dead_endpoints: dict[bytes, float] = {}

    def died(self, full_name: str) -> None:
        """The process of a node has ended."""
        self._died[full_name] = time.monotonic()

    def starts(self, full_name: str) -> None:
        """A process is about to start under the name of a node that is free."""
        if self._died.pop(full_name, None) is not None:
            self.forget(full_name)

    def forget(self, full_name: str) -> None:
        """Ignore what the graph shows under a name now, and nothing that appears there later."""
        now = time.monotonic()
        self._dead_endpoints = {gid: at for gid, at in self._dead_endpoints.items() if now - at < LINGER}
        self._dead_endpoints.update((_gid(info), now) for info in self._endpoints_of(full_name))

    def _lives(self, info: Any) -> bool:
        died = self._died.get(_node(info))
        return (died is None or time.monotonic() - died > LINGER) and _gid(info) not in self._dead_endpoints

    def has(self, full_name: str) -> bool:
        """Whether a living node of that name is in the graph."""
        return any(map(self._lives, self._endpoints_of(full_name)))

    def endpoints(self) -> Endpoints:
        nodes: set[str] = set()
        publishers: list[tuple[str, str]] = []
        subscribers: list[tuple[str, str]] = []
        for topic in self._topics():
            writers, readers = self._visible(self._publishers(topic)), self._visible(self._subscriptions(topic))
            nodes.update(writers, readers)
            if topic not in names.OF_EVERY_NODE:
                publishers += [(name, topic) for name in writers]
                subscribers += [(name, topic) for name in readers]
        return Endpoints(frozenset(nodes), tuple(sorted(publishers)), tuple(sorted(subscribers)))

    def lingering_readers(self, topic: str) -> int:
        """How many subscriptions of dead processes the graph still shows on ``topic``."""
        return sum(not self._lives(info) for info in self._subscriptions(topic))

    def _visible(self, infos: list[Any]) -> list[str]:
        return [name for info in infos if self._lives(info) and not names.is_hidden(name := _node(info))]

    def _endpoints_of(self, full_name: str) -> Iterator[Any]:
        for topic in self._topics():
            for info in (*self._publishers(topic), *self._subscriptions(topic)):
                if _node(info) == full_name:
                    yield info

    def _topics(self) -> Iterator[str]:
        return (topic for topic, _ in self._node.get_topic_names_and_types())

    def _publishers(self, topic: str) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(topic))

    def _subscriptions(self, topic: str) -> list[Any]:
        return list(self._node.get_subscriptions_info_by_topic(topic))


def _node(info: Any) -> str:
    return names.full(info.node_name, info.node_namespace)


def _gid(info: Any) -> bytes:
    return bytes(info.endpoint_gid)
