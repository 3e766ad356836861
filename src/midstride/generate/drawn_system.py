"""The component-and-connector view of a specification (the paper's figures 1 and 3), as values to draw.

Nodes and guarantees of the environment are boxes, topics, services and ROS actions are the connectors between them.
``annotate`` adds contracts and modes; ``collapse`` draws the nodes of a namespace as one box.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Final, Literal

from midstride.model.component import ComponentSpec, Mode
from midstride.model.contract import ConnectorKind, Predicate, satisfies
from midstride.model.specification import Specification
from midstride.model.wording import KIND_WORDS

# Systems with more nodes are drawn by namespace unless requested otherwise.
READABLE: Final = 40

DrawnKind = Literal["node", "group", "environment"]


@dataclass(frozen=True, slots=True)
class Port:
    """``note`` annotates the name: an input's assumption, or an output's guarantee in its normal mode."""

    name: str
    note: str = ""
    kind: ConnectorKind = "topic"


@dataclass(frozen=True, slots=True)
class Box:
    id: str
    title: str
    kind: DrawnKind = "node"
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    lines: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TopicNode:
    id: str
    name: str
    note: str = ""
    kind: ConnectorKind = "topic"


@dataclass(frozen=True, slots=True)
class Edge:
    """From a box's port to a topic, from a topic to a box's port, or (``assumed``) from the environment to a box.

    That of a service or ROS action leads from the server, as that of a topic from the publisher, whatever way its
    arrow points.
    """

    start: str
    end: str
    start_port: str = ""
    end_port: str = ""
    assumed: bool = False
    kind: ConnectorKind = "topic"


@dataclass(slots=True)
class View:
    """The elements to draw, in a stable order."""

    title: str
    boxes: list[Box] = field(default_factory=list)
    topics: list[TopicNode] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)


def view(specification: Specification, *, annotate: bool = False, collapse: bool | None = None) -> View:
    """The view of a specification. ``collapse`` None: only for more than :data:`READABLE` nodes."""
    if collapse is None:
        collapse = len(specification.nodes) > READABLE
    return _Builder(specification, annotate, collapse, View(specification.name)).build()


@dataclass(slots=True)
class _Builder:
    specification: Specification
    annotate: bool
    collapse: bool
    view: View
    boxes: dict[str, str] = field(default_factory=dict)  # the box of each role
    edges: dict[Edge, None] = field(default_factory=dict)

    def build(self) -> View:
        groups: dict[str, list[str]] = {}
        shared = _shared_namespace(self.specification.roles()) if self.collapse else ()
        for role in self.specification.roles():
            parts = role.strip("/").split("/")
            inner = len(parts) - 1 > len(shared)
            group = "/".join(parts[: len(shared) + 1]) if self.collapse and inner else ""
            if group:
                groups.setdefault(group, []).append(role)
                self.boxes[role] = f"group {group}"
            else:
                self.boxes[role] = f"node {role}"
                self.view.boxes.append(self._node(role))
        inside = self._attachments()
        for group, roles in groups.items():
            hidden = inside.get(f"group {group}", Counter())
            counts = [
                f"{number} internal {words.connector}s"
                for kind, words in KIND_WORDS.items()
                if (number := hidden[kind])
            ]
            lines = [f"{len(roles)} nodes", *counts]
            self.view.boxes.append(Box(f"group {group}", group, "group", lines=tuple(lines)))
        self._environment()
        self.view.edges = list(self.edges)
        return self.view

    # -- nodes ---------------------------------------------------------------------------------------------

    def _node(self, role: str) -> Box:
        component = self.specification.component_of(role)
        lines: list[str] = []
        for functionality in component:
            lines.append(functionality.name)
            if self.annotate:
                lines += [f"  {mode.name}: {_mode(mode)}" for mode in functionality.modes]
        title = role if component.name.lower() == role.lower() else f"{role} : {component.name}"
        container, host = self.specification.nodes[role].container, self.specification.nodes[role].host
        title = f"{title} on {host}" if host and container is None else title
        return Box(
            f"node {role}",
            title if container is None else f"{title} in {container}{f' on {host}' if host else ''}",
            inputs=tuple(
                Port(name, self._note(component.inputs[name]), component.kind_of(name))
                for name in component.input_order
            ),
            outputs=tuple(self._output(component, name) for name in component.outputs),
            lines=tuple(lines),
        )

    def _output(self, component: ComponentSpec, name: str) -> Port:
        owner = component.find_owner(name)
        note = self._note(owner.modes[0].guarantees.get(name)) if owner and owner.modes else ""
        return Port(name, note, component.kind_of(name))

    def _note(self, predicate: Predicate | None) -> str:
        return describe(predicate) if self.annotate and predicate is not None else ""

    # -- connections ---------------------------------------------------------------------------------------

    def _attachments(self) -> dict[str, Counter[ConnectorKind]]:
        """Add topics and attachments; returns the number of topics that are entirely inside each group, by kind."""
        ends: dict[str, list[tuple[str, str, bool]]] = {}
        for role in self.specification.roles():
            component = self.specification.component_of(role)
            for port, topic in self.specification.attachments_of(role):
                ends.setdefault(topic, []).append((self.boxes[role], port.port, port.port in component.outputs))
        used_outside = {offer.topic for offer in self.specification.environment}
        inside: dict[str, Counter[ConnectorKind]] = {}
        for name, connector in sorted(self.specification.connectors.items()):
            attached = ends.get(name, [])
            boxes = {box for box, _, _ in attached}
            if len(boxes) == 1 and name not in used_outside and next(iter(boxes)).startswith("group "):
                inside.setdefault(boxes.pop(), Counter())[connector.kind] += 1
                continue
            note = self._note(connector.guarantee)
            if self.annotate and connector.kind == "topic" and connector.max_publishers is not None:
                note += f", at most {connector.max_publishers} publisher{'' if connector.max_publishers == 1 else 's'}"
            self.view.topics.append(TopicNode(f"topic {name}", name, note, connector.kind))
            for box, port_name, is_output in attached:
                shown, topic = "" if box.startswith("group ") else port_name, f"topic {name}"
                edge = Edge(box, topic, shown) if is_output else Edge(topic, box, end_port=shown)
                self.edges[replace(edge, kind=connector.kind)] = None
        return inside

    def _environment(self) -> None:
        for offer in self.specification.environment:
            lines = (describe(offer.guarantee),) if self.annotate else ()
            box = Box(f"environment {offer.name}", offer.name, "environment", lines=lines)
            self.view.boxes.append(box)
            if offer.topic is not None:
                self.edges[Edge(box.id, f"topic {offer.topic}", kind=offer.guarantee.kind)] = None
                continue
            for role in self.specification.roles():
                if _assumed_by(self.specification.component_of(role), offer.guarantee):
                    self.edges[Edge(box.id, self.boxes[role], assumed=True)] = None


def _shared_namespace(roles: Iterable[str]) -> tuple[str, ...]:
    """The common namespace of all roles, such as that of a robot, for which a box would be of no use."""
    namespaces = (role.strip("/").split("/")[:-1] for role in roles)
    shared = takewhile(lambda parts: len(set(parts)) == 1, zip(*namespaces, strict=False))
    return tuple(parts[0] for parts in shared)


def _assumed_by(component: ComponentSpec, guarantee: Predicate) -> bool:
    """Return whether the guarantee satisfies an assumption of the component."""
    return any(
        isinstance(assumption, Predicate) and satisfies(guarantee, assumption)
        for functionality in component
        for mode in functionality.modes
        for assumption in mode.assumptions
    )


def describe(predicate: Predicate) -> str:
    """A predicate as text, with its type abbreviated to `pkg/Type`."""
    return str(predicate).replace("/msg/", "/", 1)


def _mode(mode: Mode) -> str:
    assumed = [describe(a) if isinstance(a, Predicate) else str(a) for a in mode.assumptions]
    given = [f"{name} : {describe(guarantee)}" for name, guarantee in sorted(mode.guarantees.items())]
    parts = [f"assumes {', '.join(assumed)}"] if assumed else []
    parts += [f"guarantees {', '.join(given)}"] if given else []
    return "; ".join(parts) or "nothing"
