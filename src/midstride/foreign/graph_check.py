"""Compares the endpoints of a node without Midstride's API with what its component declares: topics, types, QoS."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from midstride.foreign.lifecycle_managers import LifecycleManager
from midstride.model.component import ComponentSpec
from midstride.model.contract import NOTHING, ConnectorKind, Predicate, QoS, canonical_type
from midstride.model.graph_names import is_infrastructure, resolved
from midstride.model.near_miss import nearest
from midstride.model.wording import KIND_WORDS
from midstride.wire.state import Endpoint

# How long a program may take to create the endpoints that are declared (s), besides what it states (`takes`).
ENDPOINTS_TIMEOUT: Final = float(os.environ.get("MIDSTRIDE_ENDPOINTS_TIMEOUT", "20"))


def endpoints_seconds(component: ComponentSpec) -> float:
    """The time that a program of ``component`` may take to create its endpoints (s)."""
    return ENDPOINTS_TIMEOUT + (component.startup_seconds or 0.0)


@dataclass(frozen=True, slots=True)
class GraphEndpoint:
    """A publisher (``output``) or subscription of a node, as the graph shows it. ``topic`` is the full name."""

    output: bool
    topic: str
    type: str
    qos: QoS

    def __str__(self) -> str:
        return f"{self.topic} ({self.type})"


class NamedServer(NamedTuple):
    """A server of a service or ROS action, as the graph shows it. ``name`` is the full name."""

    kind: ConnectorKind
    name: str
    type: str

    def __str__(self) -> str:
        return f"{KIND_WORDS[self.kind].connector} {self.name}"

    @property
    def endpoint(self) -> Endpoint:
        """The server as a node reports it."""
        return Endpoint(kind="ROS action" if self.kind == "action" else "service", name=self.name, serves=True)


@dataclass(frozen=True, slots=True)
class Served:
    """The services and ROS actions of a node, without those of every node (``own``); whether it has a lifecycle.

    ``managers``: the other nodes that change its lifecycle state.
    ``calls``: those of other nodes that it is a client of, in words. ``servers``: all of them.
    """

    own: tuple[NamedServer, ...] = ()
    has_lifecycle: bool = False
    managers: tuple[LifecycleManager, ...] = ()
    calls: tuple[str, ...] = ()
    servers: frozenset[NamedServer] = frozenset()


#: What the graph shows of one node now.
NodeGraph: TypeAlias = Callable[[], Sequence[GraphEndpoint]]


@dataclass(frozen=True, slots=True)
class DeclaredEndpoints:
    """The endpoints of ``node`` (a full name) as ``component`` declares them.

    ``topics`` has the full name of each port's topic. What is ``found`` is what the graph shows of the node.
    """

    component: ComponentSpec
    topics: Mapping[str, str]
    node: str

    def shown(self, found: Sequence[GraphEndpoint]) -> bool:
        """Return whether the graph shows an endpoint for every port, but for those that come and go."""
        there = {(endpoint.output, endpoint.topic) for endpoint in found}
        ports = (port for port in self.component.ports() if port not in self.component.lazy)
        return all((self.component.has_output(port), self.topics[port]) in there for port in ports)

    def differences(self, found: Sequence[GraphEndpoint]) -> list[str]:
        """Every endpoint of ``node`` whose type or QoS is not the declared one, in words.

        A publisher must offer at least the QoS that is declared, and a subscription may request no more: else the
        middleware would not match what the specification connects (docs/semantics.md section 1). What the graph does
        not show yet is not judged.
        """
        component, topics, node = self.component, self.topics, self.node
        words = []
        for port in component.ports():
            output, declared = component.has_output(port), self._declared(port)
            for endpoint in found:
                if declared is None or (endpoint.output, endpoint.topic) != (output, topics[port]):
                    continue
                does = f"node {node} {'publishes' if output else 'subscribes to'}"
                kind = f"{'output' if output else 'input'} {port} of {component.name} is declared"
                if canonical_type(endpoint.type) != declared.type:
                    what = f"{endpoint.type} on {topics[port]}" if output else f"{topics[port]} as {endpoint.type}"
                    words.append(f"{does} {what}, and {kind} as {declared.type}")
                needed, offered = (declared.qos, endpoint.qos) if output else (endpoint.qos, declared.qos)
                if clauses := needed.unmet_by(offered):
                    words.append(
                        f"{does} {'on ' if output else ''}{topics[port]} with {_in_words(endpoint.qos)}, and {kind} "
                        f"with {_in_words(declared.qos)} ({', '.join(clauses)})"
                    )
        return words

    def lacking(self, found: Sequence[GraphEndpoint], missing: Sequence[str], waited: float | None = None) -> list[str]:
        """For each port that is ``missing``, what is declared, and what the node has instead.

        ``waited``: for how long it was waited (s), where that was as long as it may take.
        """
        component, topics, node = self.component, self.topics, self.node
        words = []
        for port in missing:
            output = component.has_output(port)
            kind, verb = ("publisher on", "publishes on") if output else ("subscription to", "subscribes to")
            others = [str(each) for each in self.undeclared(found) if each.output == output]
            instead = f"; it {verb} {', '.join(others)}" if others else ""
            port_kind = "output" if output else "input"
            meant = self.misnamed(found, port)
            if meant is not None and (own := _own_name(meant.topic, node)) != component.topic_of(port):
                instead += f"; did you mean `{port_kind} {port} … as {own}`?"
            elif waited is not None:
                instead = f", {waited:.0f} s after its start{instead}; {self._if_later(port, waited)}"
            words.append(
                f"node {node} has no {kind} {topics[port]}, the topic of {port_kind} {port} of {component.name}"
                + instead
            )
        return words

    def without_node(self, waited: float | None = None) -> str:
        """A process of which the graph shows no node at all, in words; ``waited`` as in :meth:`lacking`."""
        words = f"the graph shows no node {self.node} of its process"
        return words if waited is None else f"{words}, {waited:.0f} s after its start; {_if_it_takes_longer(waited)}"

    def _if_later(self, port: str, waited: float) -> str:
        """Return what to state of an endpoint that the program creates later than ``waited`` s after its start."""
        late = _if_it_takes_longer(waited)
        if not self.component.has_output(port):
            return late
        return f"{late}; if the topic exists only while something subscribes to it, state `output {port} lazy`"

    def unseen(self, found: Sequence[GraphEndpoint], missing: Sequence[str]) -> list[str]:
        """The ports that are ``missing`` for the gate in the process, although the graph shows an endpoint of them."""
        there = {(endpoint.output, endpoint.topic) for endpoint in found}
        return [port for port in missing if (self.component.has_output(port), self.topics[port]) in there]

    def unseen_in_words(self, ports: Sequence[str], why: str | None = None) -> list[str]:
        """For each of these ports, why `gate preload` is of no use, and what is; ``why``, where more is known."""
        component, topics, node = self.component, self.topics, self.node
        why = why or (
            f"the program does so without rcl, or it could not load the library; declare {component.name} with "
            "`gate relay`"
        )
        return [
            f"node {node} {'publishes on' if component.has_output(port) else 'subscribes to'} {topics[port]}, and the "
            f"library of `gate preload` does not see it: {why}"
            for port in ports
        ]

    def past_relay(self, real: Mapping[str, str], found: Sequence[GraphEndpoint]) -> list[str]:
        """For each endpoint that the node can only have because it takes no notice of the names it was given, in words.

        It publishes on the ``real`` topic of an output, past its relay; or it uses the own name of a port although
        another was given for it.
        """
        component, topics, node = self.component, self.topics, self.node
        given = {(component.has_output(port), topics[port]) for port in component.ports()}
        own = {
            (component.has_output(port), resolved(component.topic_of(port), node)): port for port in component.ports()
        }
        attached = {(True, topic): port for port, topic in real.items()}
        words = []
        for endpoint in found:
            key = endpoint.output, endpoint.topic
            if key in given or (port := own.get(key) or attached.get(key)) is None:
                continue
            kind, does = ("output", "publishes on") if endpoint.output else ("input", "subscribes to")
            name = component.topic_of(port)
            why = f"it takes no notice of the remapping `{name}:={topics[port]}`"
            if key not in own:
                why = f"{name} is remapped to {topics[port]}: did you mean `{kind} {port} as {endpoint.topic}`?"
            words.append(f"node {node} {does} {endpoint.topic} itself, for {kind} {port} of {component.name}; {why}")
        return words

    def undeclared(self, found: Sequence[GraphEndpoint]) -> list[GraphEndpoint]:
        """The endpoints that are no port of the component, by topic, and not ROS's own either."""
        ports = {(self.component.has_output(port), self.topics[port]) for port in self.component.ports()}
        return sorted(
            (
                each
                for each in found
                if (each.output, each.topic) not in ports and not is_infrastructure(each.topic, output=each.output)
            ),
            key=lambda each: (not each.output, each.topic),
        )

    def misnamed(self, found: Sequence[GraphEndpoint], port: str) -> GraphEndpoint | None:
        """Guess the endpoint of ``port`` where there is none of its name.

        Returns the undeclared endpoint of its type and direction with the most similar name, or the only one.
        """
        output, declared = self.component.has_output(port), self._declared(port)
        alike = {
            each.topic: each
            for each in self.undeclared(found)
            if each.output == output and declared is not None and canonical_type(each.type) == declared.type
        }
        near = nearest(self.component.topic_of(port), alike)
        return alike[near] if near is not None else next(iter(alike.values())) if len(alike) == 1 else None

    def _declared(self, port: str) -> Predicate | None:
        if not self.component.has_output(port):
            return self.component.inputs[port]
        owner = self.component.find_owner(port)
        guarantee = NOTHING if owner is None else owner.modes[0].guarantee(port)
        return guarantee if isinstance(guarantee, Predicate) else None


def _if_it_takes_longer(waited: float) -> str:
    return f"if it takes longer to start, state `takes {2 * waited:.0f} s` after its `run` command"


def _own_name(topic: str, node: str) -> str:
    """Return the name by which a program in the namespace of ``node`` may call ``topic``."""
    return topic.removeprefix(node.rpartition("/")[0] + "/")


def _in_words(qos: QoS) -> str:
    policies = qos.effective()
    words = [f"{policies.reliability}, {policies.durability}"]
    words += [f"{name} {given:g} s" for name in ("deadline", "lease") if (given := getattr(policies, name)) is not None]
    return ", ".join(words)
