"""The services and ROS actions that become ports: the graph shows that nodes here rely on them.

A server that nothing here calls gets no port: what may call it is not in the graph, and a server that is declared has
to be there always. A comment names it, with the reason.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Final

from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.model.contract import ConnectorKind
from midstride.model.wording import KIND_WORDS

_KINDS: Final[tuple[ConnectorKind, ...]] = ("topic", "service", "action")


def relied_on(
    graph: ObservedGraph, here: Collection[str], system: Collection[str], declared: Collection[str] = ()
) -> frozenset[ObservedEndpoint]:
    """The servers of the nodes ``here`` that other nodes of the ``system`` call, and the clients of ``here`` of these.

    ``declared``: the services and ROS actions that the specification states already, whose servers and clients
    belong to them.
    """
    candidates = [each for each in graph.services.values() if each.node in here and not why_not(graph, each)]
    servers = {
        each
        for each in candidates
        if each.output and (each.topic in declared or any(client.node in system for client in _clients(graph, each)))
    }
    stated = {each.topic for each in servers} | {*declared}
    return frozenset(servers | {each for each in candidates if not each.output and each.topic in stated})


def comments(graph: ObservedGraph, node: str, stated: Collection[ObservedEndpoint]) -> list[str]:
    """Comments on the services and ROS actions of a node that are not ``stated`` as ports: which, and why."""
    reasons: dict[str, list[str]] = {}
    for each in graph.services_of(node):
        if each not in stated:
            nothing = f"no other node here {'calls it' if each.output else 'states that it serves it'}"
            name = f"{KIND_WORDS[each.kind].connector} {each.topic}"
            reasons.setdefault(why_not(graph, each) or nothing, []).append(name)
    return [f"# no port for {', '.join(names)}: {why}" for why, names in reasons.items()]


def by_kind(graph: ObservedGraph, names: Collection[str]) -> list[str]:
    """The names of topics, services and ROS actions, in this order."""
    return sorted(names, key=lambda name: (_KINDS.index(graph.on(name)[0].kind), name))


def why_not(graph: ObservedGraph, service: ObservedEndpoint) -> str:
    """The reason why a specification cannot state a server or client, whatever relies on it; empty where it can."""
    found = graph.on(service.topic)
    if found[0].kind == "topic":
        return "a topic has the name"
    if len({each.kind for each in found}) > 1:
        return "a service and a ROS action have the name"
    servers = sorted({each.node for each in found if each.output})
    if len(servers) > 1:
        return f"{' and '.join(servers)} serve it"
    if service.output:
        return ""
    if service.node in servers:
        return "the node calls itself"
    types = {each.type for each in found if each.output}
    return f"the type that is served is {types.pop()}" if types and service.type not in types else ""


def _clients(graph: ObservedGraph, server: ObservedEndpoint) -> Iterator[ObservedEndpoint]:
    """The clients that rely on ``server``."""
    return (each for each in graph.on(server.topic) if not each.output and not why_not(graph, each))
