"""A ROS graph as it is seen: the endpoints of its nodes, and when messages were written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from midstride.model.contract import ConnectorKind, QoS, connector_kind
from midstride.model.graph_names import is_infrastructure, is_of_every_node

# The times of so many messages are kept for each publisher.
MAX_TIMES: Final = 100_000


@dataclass(frozen=True, slots=True)
class ObservedEndpoint:
    """A publisher (``output``) or a subscription, or a server (``output``) or a client of a service or ROS action.

    ``node`` and ``topic`` are full names; ``identity`` is unique among publishers and subscriptions.
    ``process`` is equal for endpoints of one process, and empty where the middleware does not tell.
    """

    node: str
    topic: str
    type: str
    output: bool
    qos: QoS
    identity: str
    process: bytes = b""

    @property
    def kind(self) -> ConnectorKind:
        return connector_kind(self.type)

    @property
    def is_infrastructure(self) -> bool:
        """Return whether the endpoint is ROS's rather than the node's, or of a hidden node."""
        if self.kind == "topic":
            return "/_" in self.node or is_infrastructure(self.topic, output=self.output)
        of_node = is_of_every_node(self.topic, self.type, self.node if self.output else None)
        return "/_" in self.node or "/_" in self.topic or of_node


@dataclass(slots=True)
class ObservedGraph:
    """The graph as far as it has been seen.

    ``seconds``: for how long; ``unreadable``: the types that could not be imported.

    ``endpoints``: publishers and subscriptions; ``services``: the servers and clients of services and ROS actions.
    ``lazy``: the nodes and topics of publishers that have gone when nothing subscribed to them any more.
    ``subscribed``: the topics that were subscribed to; ``counted``: by node and topic, when outputs were written (s, of
    one clock) whose messages the library in their process counts.
    ``processes``: by node, its process, as far as the middleware tells; ``containers``: the nodes of component
    containers; ``programs``: by container, its executable and the package of that, where its process shows them.
    ``lifecycle``: the lifecycle nodes; ``managers``: by node that changes the lifecycle state of others,
    these.
    """

    seconds: float = 0.0
    endpoints: dict[tuple[str, str, bool], ObservedEndpoint] = field(default_factory=dict)
    services: dict[tuple[str, str, bool], ObservedEndpoint] = field(default_factory=dict)
    unreadable: set[str] = field(default_factory=set)
    lazy: set[tuple[str, str]] = field(default_factory=set)
    subscribed: set[str] = field(default_factory=set)
    counted: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    lifecycle: set[str] = field(default_factory=set)
    managers: dict[str, set[str]] = field(default_factory=dict)
    processes: dict[str, str] = field(default_factory=dict)
    containers: set[str] = field(default_factory=set)
    programs: dict[str, tuple[str, str]] = field(default_factory=dict)
    # By node and service or ROS action, how long each response took (s), where the library in its process shows that.
    took: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    _times: dict[tuple[str, str], list[float]] = field(default_factory=dict)

    def saw(self, endpoints: Iterable[ObservedEndpoint]) -> None:
        """The graph shows these endpoints now."""
        for endpoint in endpoints:
            if not endpoint.is_infrastructure:
                among = self.endpoints if endpoint.kind == "topic" else self.services
                among[endpoint.node, endpoint.topic, endpoint.output] = endpoint

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
        """The times at which ``endpoint`` published, as far as it can be distinguished from others on its topic."""
        if (counted := self.counted.get((endpoint.node, endpoint.topic))) is not None:
            return counted
        if (endpoint.topic, endpoint.identity) in self._times:
            return self._times[endpoint.topic, endpoint.identity]
        if len(self.publishers(endpoint.topic)) > 1:
            return None if (endpoint.topic, "") in self._times else []
        return self._times.get((endpoint.topic, ""), [])

    def renamed(self, names: Mapping[str, str]) -> ObservedGraph:
        """Return the same with other names for some nodes: by the name that the graph shows."""

        def name_of(node: str) -> str:
            return names.get(node, node)

        def of_nodes(
            endpoints: Mapping[tuple[str, str, bool], ObservedEndpoint],
        ) -> dict[tuple[str, str, bool], ObservedEndpoint]:
            return {
                (name_of(node), topic, output): replace(each, node=name_of(node))
                for (node, topic, output), each in endpoints.items()
            }

        return replace(
            self,
            endpoints=of_nodes(self.endpoints),
            services=of_nodes(self.services),
            counted={(name_of(node), topic): times for (node, topic), times in self.counted.items()},
            lazy={(name_of(node), topic) for node, topic in self.lazy},
            lifecycle={*map(name_of, self.lifecycle)},
            processes={name_of(node): process for node, process in self.processes.items()},
            containers={*map(name_of, self.containers)},
            programs={name_of(node): program for node, program in self.programs.items()},
            managers={name_of(node): {*map(name_of, managed)} for node, managed in self.managers.items()},
            took={(name_of(node), name): took for (node, name), took in self.took.items()},
        )

    def topics(self) -> set[str]:
        """The full names of the topics with a publisher."""
        return {each.topic for each in self.endpoints.values() if each.output}

    def on(self, name: str) -> list[ObservedEndpoint]:
        """The endpoints of a topic; where there is none of that name, of a service or ROS action."""
        among = (self.endpoints, self.services)
        found = ([each for each in endpoints.values() if each.topic == name] for endpoints in among)
        return next(filter(None, found), [])

    def nodes(self) -> list[str]:
        """The full names of the nodes with publishers or subscriptions."""
        return sorted({endpoint.node for endpoint in self.endpoints.values()})

    def of_node(self, node: str) -> list[ObservedEndpoint]:
        """The publishers and subscriptions of a node."""
        return _ordered(each for each in self.endpoints.values() if each.node == node)

    def services_of(self, node: str) -> list[ObservedEndpoint]:
        """The servers and clients of a node."""
        return _ordered(each for each in self.services.values() if each.node == node)


def _ordered(endpoints: Iterable[ObservedEndpoint]) -> list[ObservedEndpoint]:
    return sorted(endpoints, key=lambda each: (each.output, each.topic))
