"""All that the files of a system declare, by full name, with duplicates reported.

Namespaces are resolved here, as ROS does it: a relative name is in the namespace it stands in, one that begins with
a slash is in none. Components, contracts and resources are in no namespace: they are kinds of things, not things.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeVar

from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.files import Placed, join
from midstride.lang.source import Span
from midstride.lang.syntax import (
    ComponentDeclaration,
    ConstraintStatement,
    ContractDeclaration,
    Duration,
    EnvironmentBlock,
    EnvironmentOffer,
    IncludeStatement,
    Item,
    Name,
    NamespaceBlock,
    NodeDeclaration,
    OrderStatement,
    ParameterFile,
    ResourceDeclaration,
    TimingBlock,
    TopicDeclaration,
)

T = TypeVar("T")

# More of one kind in one declaration than this nobody wrote by hand; what is judged pair by pair would take long.
MAX_PARTS: Final = 1000


def bounded(
    entries: Sequence[T], what: str, span_of: Callable[[T], Span], reporter: Reporter, room: int = MAX_PARTS
) -> Sequence[T]:
    """``entries``, as many as are looked at (``room``); that there are more is reported."""
    if len(entries) > room:
        message = f"there are more than {MAX_PARTS} parts of one kind here: {what}"
        if any(other.code == "E145" and other.message == message for other in reporter.found):
            return entries[: max(room, 0)]
        reporter.report("E145", span_of(entries[max(room, 0)]), message, help="divide what they belong to")
    return entries[: max(room, 0)]


class NodeEntry(NamedTuple):
    role: str
    namespace: str
    declaration: NodeDeclaration


class OfferEntry(NamedTuple):
    namespace: str
    declaration: EnvironmentOffer


class ConstraintEntry(NamedTuple):
    namespace: str
    statement: ConstraintStatement


class FileEntry(NamedTuple):
    namespace: str
    path: Name


@dataclass(slots=True)
class Declarations:
    """By full name, in order of declaration."""

    system: Name | None = None
    contracts: dict[str, ContractDeclaration] = field(default_factory=dict)
    components: dict[str, ComponentDeclaration] = field(default_factory=dict)
    resources: dict[str, ResourceDeclaration] = field(default_factory=dict)
    topics: dict[str, TopicDeclaration] = field(default_factory=dict)
    offers: dict[str, OfferEntry] = field(default_factory=dict)
    nodes: dict[str, NodeEntry] = field(default_factory=dict)
    constraints: list[ConstraintEntry] = field(default_factory=list)
    parameter_files: list[FileEntry] = field(default_factory=list)
    timing: dict[str, Duration] = field(default_factory=dict)


def topic_name(namespace: str, name: str, node: str | None = None) -> str:
    """The full name of a topic: ``scan`` in ``robot1`` is ``/robot1/scan``; ``~/scan`` of a node is in the node's own
    name."""
    if name.startswith("~"):
        return "/" + join(namespace, node or "") + name[1:]
    return "/" + join(namespace, name)


def collect(placed: Iterable[Placed], reporter: Reporter) -> Declarations:
    """The declarations of all files."""
    found = Declarations()
    collector = _Collector(found, reporter)
    for index, place in enumerate(placed):
        if index == 0:
            found.system = place.file.system
        collector.items(place.file.items, place.namespace)
    return found


class _Collector:
    def __init__(self, found: Declarations, reporter: Reporter) -> None:
        self.found = found
        self.reporter = reporter
        self.orders = 0

    def items(self, items: Iterable[Item], namespace: str) -> None:
        found = self.found
        for item in items:
            if isinstance(item, NodeDeclaration):
                role = join(namespace, item.name.text)
                self._add(
                    found.nodes,
                    role,
                    NodeEntry(role, namespace, item),
                    item.name,
                    "node",
                    lambda n: n.declaration.name.span,
                )
            elif isinstance(item, TopicDeclaration):
                self._topic(item, namespace)
            elif isinstance(item, ContractDeclaration):
                self._add(found.contracts, item.name.text, item, item.name, "contract", lambda c: c.name.span)
            elif isinstance(item, ComponentDeclaration):
                self._add(found.components, item.name.text, item, item.name, "component", lambda c: c.name.span)
            elif isinstance(item, ResourceDeclaration):
                self._add(found.resources, item.name.text, item, item.name, "resource", lambda r: r.name.span)
            elif isinstance(item, EnvironmentBlock):
                room = MAX_PARTS - len(found.offers)
                for offer in bounded(item.offers, "guarantee", lambda offer: offer.name.span, self.reporter, room):
                    name = join(namespace, offer.name.text).replace("/", "_")
                    entry = OfferEntry(namespace, offer)
                    self._add(
                        found.offers,
                        name,
                        entry,
                        offer.name,
                        "guarantee of the environment",
                        lambda o: o.declaration.name.span,
                    )
            elif isinstance(item, TimingBlock):
                for duration in item.durations:
                    self._add(
                        found.timing, duration.kind.text, duration, duration.kind, "time for", lambda d: d.kind.span
                    )
            elif isinstance(item, NamespaceBlock):
                self.items(item.items, join(namespace, item.name.text))
            elif isinstance(item, ParameterFile):
                found.parameter_files.append(FileEntry(namespace, item.path))
            elif isinstance(item, OrderStatement):
                self.orders += 1
                room = 1 if self.orders <= MAX_PARTS else 0
                for order in bounded((item,), "order", lambda order: order.span, self.reporter, room):
                    found.constraints.append(ConstraintEntry(namespace, order))
            elif not isinstance(item, IncludeStatement):
                found.constraints.append(ConstraintEntry(namespace, item))

    def _topic(self, item: TopicDeclaration, namespace: str) -> None:
        name = item.name.text
        if name.startswith("~"):
            message = f"`{name}` is private to a node, and no node is meant here"
            self.reporter.report("E139", item.name.span, message, help="write the full name: `/node/topic`")
            return
        full = topic_name(namespace, name)
        self._add(self.found.topics, full, item, item.name, "topic", lambda t: t.name.span)

    def _add(self, table: dict[str, T], full: str, item: T, name: Name, what: str, span_of: object) -> None:
        if full not in table:
            table[full] = item
            return
        first: Span = span_of(table[full])  # type: ignore[operator]  # a function of the table's entries
        if first == name.span:
            return  # one declaration, included in several namespaces
        note = Note("the first one is here", first)
        self.reporter.report(
            "E007", name.span, f"there is a {what} `{full}` already", help="give each its own name", notes=[note]
        )
