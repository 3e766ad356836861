"""The declarations of all files of a system, by full name; duplicates are reported.

Names are resolved as in ROS: a relative name belongs to the enclosing namespace, one that starts with a slash is
absolute. Components, contracts and resources are global: they are types, not instances.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeVar

from midstride.lang import syntax
from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.source import Span
from midstride.lang.source_files import NamespacedFile, resolve_name
from midstride.model.hosts import OWN_HOST, host_in_words, host_of_word, resource_key

T = TypeVar("T")

# A limit per declaration that no hand-written file reaches: some checks compare all pairs.
MAX_PARTS: Final = 1000


def limited(
    entries: Sequence[T], what: str, span_of: Callable[[T], Span], reporter: Reporter, limit: int = MAX_PARTS
) -> Sequence[T]:
    """The first ``limit`` entries; reports that there are more."""
    limit = max(limit, 0)
    if len(entries) > limit:
        report_excess(what, span_of(entries[limit]), reporter)
    return entries[:limit]


def report_excess(what: str, span: Span, reporter: Reporter) -> None:
    """Report, once for each kind, the first entry that is too many."""
    message = f"more than {MAX_PARTS} entries of one kind: {what}"
    if all(other.code != "E145" or other.message != message for other in reporter.found):
        reporter.report("E145", span, message, help="split the declaration")


class NodeEntry(NamedTuple):
    role: str
    namespace: str
    declaration: syntax.NodeDeclaration


class OfferEntry(NamedTuple):
    namespace: str
    declaration: syntax.EnvironmentOffer


@dataclass(slots=True)
class Declarations:
    """All declarations by full name, in source order; constraints and parameter files with their namespaces.

    Resources are by their keys, and nodes, containers and resources have the host of what encloses them, unless they
    state their own.
    """

    system: syntax.Name | None = None
    contracts: dict[str, syntax.ContractDeclaration] = field(default_factory=dict)
    components: dict[str, syntax.ComponentDeclaration] = field(default_factory=dict)
    resources: dict[str, syntax.ResourceDeclaration] = field(default_factory=dict)
    topics: dict[str, syntax.TopicDeclaration] = field(default_factory=dict)
    hosts: dict[str, syntax.HostDeclaration] = field(default_factory=dict)
    around: list[syntax.Name] = field(default_factory=list)  # the hosts that namespaces and included files are on
    containers: dict[str, syntax.ContainerDeclaration] = field(default_factory=dict)
    offers: dict[str, OfferEntry] = field(default_factory=dict)
    nodes: dict[str, NodeEntry] = field(default_factory=dict)
    constraints: list[tuple[str, syntax.ConstraintStatement]] = field(default_factory=list)
    parameter_files: list[tuple[str, syntax.Name]] = field(default_factory=list)
    timing: dict[str, syntax.StepDuration] = field(default_factory=dict)
    requirements: list[tuple[str, syntax.ChangesStatement]] = field(default_factory=list)


def resolve_topic(namespace: str, name: str, node: str | None = None) -> str:
    """The full name of a topic: ``scan`` in ``robot1`` is ``/robot1/scan``; ``~/scan`` is private to ``node``."""
    if name.startswith("~"):
        return "/" + resolve_name(namespace, node or "") + name[1:]
    return "/" + resolve_name(namespace, name)


def host_of(name: syntax.Name | None) -> str:
    """The name in the model of a host that the text names, if it does."""
    return OWN_HOST if name is None else host_of_word(name.text)


def ancestry(components: Mapping[str, syntax.ComponentDeclaration], name: str) -> Iterator[syntax.ComponentDeclaration]:
    """The component of that name and those that it is like, each once, as far as they are declared."""
    seen: set[str] = set()
    while name in components and name not in seen:
        seen.add(name)
        yield components[name]
        like = components[name].like
        name = "" if like is None else like.text


def collect(files_in_order: Iterable[NamespacedFile], reporter: Reporter) -> Declarations:
    """The declarations of all files; the first file names the system."""
    found = Declarations()
    collector = _Collector(found, reporter)
    for index, place in enumerate(files_in_order):
        if index == 0:
            found.system = place.file.system
        collector.items(place.file.items, place.namespace, place.host)
    return found


@dataclass(slots=True)
class _Collector:
    found: Declarations
    reporter: Reporter
    orders: int = 0
    first: dict[tuple[str, str], Span] = field(default_factory=dict)  # where each name of each kind is declared first
    on: dict[tuple[str, str], syntax.Name | None] = field(default_factory=dict)  # the host that each is on

    def items(self, items: Iterable[syntax.Item], namespace: str, host: syntax.Name | None = None) -> None:
        found = self.found
        for item in items:
            match item:
                case syntax.NodeDeclaration(name=name):
                    role, placed = resolve_name(namespace, name.text), item._replace(host=item.host or host)
                    self._add(found.nodes, role, NodeEntry(role, namespace, placed), name, "node", placed.host)
                case syntax.TopicDeclaration():
                    self._topic(item, namespace)
                case syntax.ContractDeclaration(name=name):
                    self._add(found.contracts, name.text, item, name, "contract")
                case syntax.ComponentDeclaration(name=name):
                    self._add(found.components, name.text, item, name, "component")
                case syntax.ResourceDeclaration(name=name):
                    of_host = item._replace(host=item.host or host)
                    key = resource_key(name.text, host_of(of_host.host))
                    self._add(found.resources, key, of_host, name, "resource")
                case syntax.HostDeclaration(name=name):
                    self._add(found.hosts, name.text, item, name, "host")
                case syntax.ContainerDeclaration(name=name):
                    full, on_host = resolve_name(namespace, name.text), item._replace(host=item.host or host)
                    self._add(found.containers, full, on_host, name, "container", on_host.host)
                case syntax.EnvironmentOffer(name=name):
                    full = resolve_name(namespace, name.text).replace("/", "_")
                    if len(found.offers) < MAX_PARTS:
                        self._add(found.offers, full, OfferEntry(namespace, item), name, "environment guarantee")
                    else:
                        report_excess("guarantee", name.span, self.reporter)
                case syntax.StepDuration(kind=kind):
                    self._add(found.timing, kind.text, item, kind, "time for")
                case syntax.NamespaceBlock(name=name):
                    found.around += filter(None, [item.host])
                    self.items(item.items, resolve_name(namespace, name.text), item.host or host)
                case syntax.IncludeStatement(host=on):
                    found.around += filter(None, [on])
                case syntax.ParameterFile(path=path):
                    found.parameter_files.append((namespace, path))
                case syntax.OrderStatement():
                    self.orders += 1
                    if self.orders <= MAX_PARTS:
                        found.constraints.append((namespace, item))
                    else:
                        report_excess("order", item.span, self.reporter)
                case syntax.ChangesStatement():
                    if len(found.requirements) < MAX_PARTS:
                        found.requirements.append((namespace, item))
                    else:
                        report_excess("changes", item.span, self.reporter)
                case syntax.KeepStatement() | syntax.LimitStatement():
                    found.constraints.append((namespace, item))

    def _topic(self, item: syntax.TopicDeclaration, namespace: str) -> None:
        name = item.name.text
        if name.startswith("~"):
            message = f"`{name}` is private to a node, but this is not inside one"
            self.reporter.report("E139", item.name.span, message, help="write the full name: `/node/topic`")
            return
        self._add(self.found.topics, resolve_topic(namespace, name), item, item.name, "topic")

    def _add(
        self,
        table: dict[str, T],
        full: str,
        item: T,
        name: syntax.Name,
        what: str,
        host: syntax.Name | None = None,
    ) -> None:
        """``host``: the one that it is on; a file that is included on two hosts declares it twice."""
        if full not in table:
            table[full] = item
            self.first[what, full] = name.span
            self.on[what, full] = host
            return
        first, on = self.first[what, full], self.on[what, full]
        if first != name.span:  # else one declaration, included in several namespaces
            note = Note("first declared here", first)
            message = f"{what} `{full}` is already declared"
            self.reporter.report("E007", name.span, message, help="use another name", notes=[note])
        elif host_of(on) != host_of(host):
            places = " and on ".join(host_in_words(host_of(each)) for each in (on, host))
            message = f"{what} `{full}` is on {places}: its file is included on both"
            at = host or on or name
            help = f"include the file in another namespace the second time, or move {what} `{name.text}` out of it"
            self.reporter.report("E007", at.span, message, help=help)
