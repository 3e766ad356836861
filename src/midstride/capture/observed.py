"""What is seen of a ROS graph: the endpoints of its nodes, and when messages were written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from midstride.model.contract import QoS
from midstride.model.graph_names import is_infrastructure

# The times of so many messages are kept for each publisher.
MAX_TIMES: Final = 100_000


@dataclass(frozen=True, slots=True)
class ObservedEndpoint:
    """A publisher (``output``) or a subscription. ``node`` and ``topic`` are full names; ``identity`` is unique."""

    node: str
    topic: str
    type: str
    output: bool
    qos: QoS
    identity: str

    @property
    def is_infrastructure(self) -> bool:
        """Whether it is ROS's own rather than the node's, or of a hidden node."""
        return "/_" in self.node or is_infrastructure(self.topic, output=self.output)


@dataclass(slots=True)
class ObservedGraph:
    """What has been seen so far. ``seconds``: for how long; ``unreadable``: the types that could not be imported.

    ``lazy``: the nodes and topics of publishers that have gone when nothing subscribed to them any more.
    ``lifecycle``: the lifecycle nodes, and ``managers``: by node that changes the lifecycle state of others, these.
    """

    seconds: float = 0.0
    endpoints: dict[tuple[str, str, bool], ObservedEndpoint] = field(default_factory=dict)
    unreadable: set[str] = field(default_factory=set)
    lazy: set[tuple[str, str]] = field(default_factory=set)
    lifecycle: set[str] = field(default_factory=set)
    managers: dict[str, set[str]] = field(default_factory=dict)
    _times: dict[tuple[str, str], list[float]] = field(default_factory=dict)

    def saw(self, endpoints: Iterable[ObservedEndpoint]) -> None:
        """The graph shows these endpoints now."""
        for endpoint in endpoints:
            if not endpoint.is_infrastructure:
                self.endpoints[endpoint.node, endpoint.topic, endpoint.output] = endpoint

    def heard(self, topic: str, publisher: str | None, time: float) -> None:
        """A message on ``topic`` was written at ``time`` (s), by the publisher of that identity, if that is known."""
        times = self._times.setdefault((topic, publisher or ""), [])
        if len(times) < MAX_TIMES:
            times.append(time)

    def managers_of(self, node: str) -> list[str]:
        """The nodes that change the lifecycle state of ``node``."""
        return sorted(name for name, nodes in self.managers.items() if node in nodes)

    def publishers(self, topic: str) -> list[ObservedEndpoint]:
        return [each for each in self.endpoints.values() if each.output and each.topic == topic]

    def times(self, endpoint: ObservedEndpoint) -> list[float] | None:
        """When ``endpoint`` published, as far as it can be distinguished from others on its topic."""
        if (endpoint.topic, endpoint.identity) in self._times:
            return self._times[endpoint.topic, endpoint.identity]
        if len(self.publishers(endpoint.topic)) > 1:
            return None if (endpoint.topic, "") in self._times else []
        return self._times.get((endpoint.topic, ""), [])

    def topics(self) -> set[str]:
        """The full names of the topics with a publisher."""
        return {each.topic for each in self.endpoints.values() if each.output}

    def nodes(self) -> list[str]:
        """The full names of the nodes with endpoints."""
        return sorted({endpoint.node for endpoint in self.endpoints.values()})

    def of_node(self, node: str) -> list[ObservedEndpoint]:
        found = (each for each in self.endpoints.values() if each.node == node)
        return sorted(found, key=lambda each: (each.output, each.topic))
