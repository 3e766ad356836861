"""Adds what a graph proposes to a specification, without touching what it states already."""

from __future__ import annotations

import shlex
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeGuard

from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.capture.probe import Dependences
from midstride.capture.proposal import (
    ProposedPort,
    component_text,
    free_name,
    merged,
    node_block,
    own_name,
    ports_of,
    topic_lines,
)
from midstride.capture.reliance import by_kind, comments, relied_on, why_not
from midstride.capture.taken_over import gate_of_lifecycle, require_all, words_on
from midstride.errors import SpecificationError
from midstride.lang.diagnostic_text import Reporter
from midstride.lang.parser import parse
from midstride.lang.printer import format_text
from midstride.lang.source import Source
from midstride.lang.source_files import resolve_name
from midstride.lang.syntax import (
    ComponentDeclaration,
    File,
    Item,
    NamespaceBlock,
    NodeDeclaration,
    OrderStatement,
    TopicDeclaration,
)
from midstride.model.contract import ConnectorKind
from midstride.model.lifecycle_management import Management


@dataclass(slots=True)
class Insertion:
    """The new text, the nodes that got ports, and, by full name, why others of the graph or the file did not.

    ``ports``: how many they got.
    ``lifecycle``: what manages the lifecycle nodes from now on, in sentences.
    """

    text: str
    added: list[str] = field(default_factory=list)
    ports: int = 0
    left: dict[str, str] = field(default_factory=dict)
    lifecycle: list[str] = field(default_factory=list)


def insert(
    text: str,
    name: str,
    graph: ObservedGraph,
    rates: bool = False,
    findings: Dependences | None = None,
    management: Management | None = None,
) -> Insertion:
    """``text``, the file ``name``, with the ports of its nodes, and what manages the lifecycle of those that have one.

    Raises SpecificationError if it cannot be parsed, or if Midstride is to manage lifecycle nodes that it does not
    have.
    """
    return _Inserter(text, name, graph, rates, findings, management).insertion()


def nodes_without_ports(text: str, name: str) -> list[str]:
    """The full names of the nodes that can get ports. Raises SpecificationError."""
    inserter = _Inserter(text, name, ObservedGraph(), False)
    return [full for _, full, _ in inserter.open_nodes(Insertion(""))]


class _Inserter:
    def __init__(
        self,
        text: str,
        name: str,
        graph: ObservedGraph,
        rates: bool,
        findings: Dependences | None = None,
        management: Management | None = None,
    ) -> None:
        reporter = Reporter()
        self.file: File = parse(Source(name, text, Path(name)), reporter)
        if reporter.has_errors:
            raise SpecificationError([str(each) for each in reporter.found])
        self.name, self.graph, self.rates, self.findings = name, graph, rates, findings
        self.management = management
        self.components = {
            item.name.text: item
            for item, _ in self._items(self.file.items, "")
            if isinstance(item, ComponentDeclaration)
        }
        self.used = set(self.components)
        self.names = {
            id(item): "/" + resolve_name(inside, item.name.text)
            for item, inside in self._items(self.file.items, "")
            if isinstance(item, NodeDeclaration)
        }
        self.edits: list[tuple[int, int, str]] = []
        self.services: frozenset[ObservedEndpoint] = frozenset()

    def _items(self, items: tuple[Item, ...], namespace: str) -> Iterator[tuple[Item, str]]:
        for item in items:
            if isinstance(item, NamespaceBlock):
                yield from self._items(item.items, resolve_name(namespace, item.name.text))
            else:
                yield item, namespace

    def insertion(self) -> Insertion:
        result = Insertion("")
        open_ = list(self.open_nodes(result))
        self.services = self._services(open_)
        found, seen = [], {*self.graph.nodes(), *(each.node for each in self.services)}
        for each in open_:
            if each[1] in seen:
                found.append(each)
            elif self.graph.services_of(each[1]):
                result.left[each[1]] = "it has no topics, and its services get no ports"
            elif any(run.unnamed for run in each[2].runs):
                result.left[each[1]] = (
                    "its program gives its node another name, which is known while it runs under `midstride up`, or it "
                    "has no topics"
                )
            else:
                result.left[each[1]] = "it is not in the graph, or has no topics"
        in_file = {*result.left, *(full for _, full, _ in found)}
        result.left |= dict.fromkeys(sorted(seen - in_file), "it is not in this file")
        ports = {
            full: ports_of(self.graph, full, self._remaps(component, full), self.findings, self.services)
            for _, full, component in found
        }
        heard = {port.endpoint.topic for each in ports.values() for port in each if port.endpoint.output}
        heard |= self._declared_topics("service", "action")
        stated: list[ProposedPort] = []
        for component in {id(each): each for _, _, each in found}.values():
            members = [(node, ports[full]) for node, full, other in found if other is component]
            stated += self._complete(component, members, heard)
        for node, full, _ in found:
            self._attach(node, ports[full])
            result.added.append(full)
            result.ports += len(ports[full])
        named = {port.endpoint.topic for each in ports.values() for port in each}
        topics = by_kind(self.graph, named - self._declared_topics("topic", "service", "action"))
        self._declare(topic_lines(self.graph, topics, stated if self.rates else ()))
        self._manage_lifecycle(result)
        result.text = self._text()
        return result

    def open_nodes(self, result: Insertion) -> list[tuple[NodeDeclaration, str, ComponentDeclaration]]:
        """The nodes whose components state no ports, with their full names; the others are noted in ``result``."""
        found = []
        for item, _ in self._items(self.file.items, ""):
            if isinstance(item, NodeDeclaration):
                full = self.names[id(item)]
                component = self.components.get(item.component.text if item.component else "")
                if self._is_left_out(full):
                    result.left[full] = "Midstride manages what it managed"
                elif component is None:
                    result.left[full] = "its component is not in this file"
                elif any(run.once is not None for run in component.runs):  # it is not waited for
                    result.left[full] = "its program ends when it has done its work (`once`)"
                elif component.inputs or component.outputs or component.functionalities or component.like:
                    result.left[full] = "its component states its ports"
                else:
                    found.append((item, full, component))
        return found

    def _services(self, nodes: list[tuple[NodeDeclaration, str, ComponentDeclaration]]) -> frozenset[ObservedEndpoint]:
        """The servers and clients that become ports: those that are relied on, and the same ones of nodes that share a
        component with theirs.

        Only `gate preload` and `gate lifecycle preload` hand requests over, and allow several functionalities.
        """
        here = {full: component for _, full, component in nodes if self._is_preloaded(component)}
        system = {full for full in self.names.values() if not self._is_left_out(full)}
        found = relied_on(self.graph, here, system, self._declared_topics("service", "action"))
        shared = {(id(here[each.node]), self._own_name(each, here), each.output, each.type) for each in found}
        return found | {
            each
            for full, component in here.items()
            for each in self.graph.services_of(full)
            if (id(component), self._own_name(each, here), each.output, each.type) in shared
            if not why_not(self.graph, each)
        }

    def _own_name(self, endpoint: ObservedEndpoint, components: Mapping[str, ComponentDeclaration]) -> str:
        return own_name(endpoint, self._remaps(components[endpoint.node], endpoint.node))

    @staticmethod
    def _is_preloaded(component: ComponentDeclaration) -> bool:
        """Return whether the library is loaded into the program, or no command that starts it is stated."""
        gates = [None if run.gate is None else run.gate.text for run in component.runs]
        return all(gate in ("preload", "lifecycle preload") for gate in gates)

    def _is_left_out(self, node: str) -> bool:
        """Return whether Midstride manages from now on what ``node`` managed."""
        return self.management == "midstride" and bool(self.graph.managers.get(node))

    def _declared_topics(self, *kinds: ConnectorKind) -> set[str]:
        items = self._items(self.file.items, "")
        return {
            "/" + resolve_name(inside, item.name.text)
            for item, inside in items
            if isinstance(item, TopicDeclaration) and item.kind in kinds
        }

    # -- edits -----------------------------------------------------------------------------------------------

    def _text(self) -> str:
        original = self.file.tokens.source.text
        text = _edited(original, self.edits)
        formatted = format_text(text, self.name)
        assert formatted.text is not None, [str(each) for each in formatted.diagnostics]
        return formatted.text if format_text(original).text == original else text

    def _complete(
        self,
        component: ComponentDeclaration,
        nodes: list[tuple[NodeDeclaration, list[ProposedPort]]],
        heard: set[str],
    ) -> list[ProposedPort]:
        """Give the component the ports of its nodes. Where these differ, further nodes get copies of the component.

        Returns those of every node, with the rates that the components state.
        """
        variants: dict[tuple[str, ...], list[tuple[NodeDeclaration, list[ProposedPort]]]] = {}
        for node, ports in nodes:
            declared = tuple(replace(each, lazy=False).declaration() + each.contract for each in ports)
            if self._takes_over(self.names[id(node)]):
                declared = (*declared, "gate lifecycle")
            variants.setdefault(declared, []).append((node, ports))
        close = self._end_of_block(component.name.span.start)
        if close is None:
            return []
        start, stated = component.name.span.end, list[ProposedPort]()
        for number, members in enumerate(variants.values()):
            ports = merged(ports for _, ports in members)
            alike = zip(*(own for _, own in members), strict=True)
            # An input for which one of them has no publisher: assumed, that one would start degraded.
            unheard = {same[0].endpoint.topic for same in alike if not heard.issuperset(p.endpoint.topic for p in same)}
            stated += [
                replace(port, rate=same.rate) for _, own in members for port, same in zip(own, ports, strict=True)
            ]
            lines = component_text(ports, heard - unheard, self.rates)
            if self._is_preloaded(component):
                lines += comments(self.graph, self.names[id(members[0][0])], self.services)
            commands = self._commands(component, ports, self._takes_over(self.names[id(members[0][0])]))
            if number == 0:
                self.edits += [(start + first, start + last, new) for first, last, new in commands]
                self._insert_before(close, lines)
                continue
            body = _edited(self.file.tokens.source.text[start:close], commands)
            name = free_name(component.name.text, self.used)
            self.used.add(name)
            self.edits.append((close + 1, close + 1, "\n".join([f"\n\ncomponent {name}{body}", *lines, "}"])))
            for node, _ in members:
                if node.component is not None:
                    self.edits.append((node.component.span.start, node.component.span.end, name))
        return stated

    def _commands(
        self, component: ComponentDeclaration, ports: list[ProposedPort], lifecycle: bool
    ) -> list[tuple[int, int, str]]:
        """The changes of the component's command, and of its gate if it is a ``lifecycle`` node, after its name."""
        own, start = {port.own_topic for port in ports}, component.name.span.end
        found = []
        for run in component.runs:
            command = without_remaps(run.command.text, own)
            if command != run.command.text:
                escaped = command.replace("\\", "\\\\").replace('"', '\\"')
                found.append((run.command.span.start - start, run.command.span.end - start, f'"{escaped}"'))
        if lifecycle:
            found += [(first - start, last - start, new) for first, last, new in self._gates(component)]
        return found

    # -- lifecycle nodes ----------------------------------------------------------------------------------------

    def _takes_over(self, node: str) -> bool:
        """Return whether Midstride manages the lifecycle of a node (a full name) from now on."""
        return gate_of_lifecycle(self.graph, node, self.management) is not None

    def _gates(self, component: ComponentDeclaration) -> list[tuple[int, int, str]]:
        """The changes of the component's gate that have Midstride manage its lifecycle, as offsets."""
        new = {"preload": "lifecycle preload", "none": "lifecycle"}
        return [
            (run.gate.span.start, run.gate.span.end, new[run.gate.text])
            for run in component.runs
            if run.gate is not None and run.gate.text in new
        ]

    def _manage_lifecycle(self, result: Insertion) -> None:
        """Say what manages the lifecycle nodes; where Midstride is to, change their gates, and leave the manager out.

        Raises SpecificationError if Midstride is to manage nodes that this file does not have.
        """
        nodes = [(item, inside) for item, inside in self._items(self.file.items, "") if self._is_node(item)]
        here = {self.names[id(item)]: item for item, _ in nodes}
        already = {full for full, item in here.items() if self._has_lifecycle_gate(item)}
        result.lifecycle = words_on(self.graph, self.management, here, already)
        if self.management != "midstride":
            return
        require_all(self.graph, here, self.name)
        stated = {
            component.name.text: component
            for full, item in here.items()
            if full not in result.added and self._takes_over(full)
            if (component := self.components.get(item.component.text if item.component else "")) is not None
        }
        for component in stated.values():
            self.edits += self._gates(component)
        managers = {full for full in here if self.graph.managers.get(full)}
        for item, inside in self._items(self.file.items, ""):
            if isinstance(item, OrderStatement):
                if managers & {"/" + resolve_name(inside, each.text) for each in (item.first, item.then)}:
                    self.edits.append((item.span.start, item.then.span.end, ""))
            elif isinstance(item, NodeDeclaration) and (full := self.names[id(item)]) in managers:
                start, end = self._statement_of(item)
                self.edits = [each for each in self.edits if not start <= each[0] < end]
                self.edits.append((start, end, f"# {full} is left out: Midstride manages the lifecycle of its nodes"))

    def _has_lifecycle_gate(self, node: NodeDeclaration) -> bool:
        component = self.components.get(node.component.text if node.component else "")
        runs = () if component is None else component.runs
        return any(run.gate is not None and run.gate.text.startswith("lifecycle") for run in runs)

    @staticmethod
    def _is_node(item: Item) -> TypeGuard[NodeDeclaration]:
        return isinstance(item, NodeDeclaration)

    def _statement_of(self, node: NodeDeclaration) -> tuple[int, int]:
        """The offsets at which the declaration of a node begins and ends."""
        tokens = self.file.tokens
        start = tokens.starts[bisect_left(tokens.starts, node.name.span.start) - 1]  # the word `node`
        close = self._end_of_block(node.name.span.start)
        end = (node.container or node.component or node.name).span.end
        return start, end if close is None else close + 1

    def _attach(self, node: NodeDeclaration, ports: list[ProposedPort]) -> None:
        if not ports or node.component is None:
            return
        if (close := self._end_of_block(node.name.span.start)) is not None:
            self._insert_before(close, [port.attachment for port in ports])
        else:
            end = (node.container or node.component).span.end
            self.edits.append((end, end, f" {node_block(ports)}"))

    def _declare(self, lines: list[str]) -> None:
        if lines and self.file.system is not None:
            source = self.file.tokens.source
            line, _ = source.position(self.file.system.span.start)
            end = source.offset(line, len(source.line(line)) + 1)
            self.edits.append((end, end, "\n\n" + "\n".join(lines)))

    def _insert_before(self, offset: int, lines: list[str]) -> None:
        self.edits.append((offset, offset, "\n" + "\n".join(lines) + "\n"))

    def _end_of_block(self, name: int) -> int | None:
        """The offset at which the block of a declaration closes, by the offset of its name; None if it has none."""
        tokens = self.file.tokens
        index = bisect_left(tokens.starts, name)
        for at in range(index, min(index + 6, len(tokens.starts))):  # `X {`, `X like Y {`, `x : X {`, `x : X in y {`
            if at in self.file.layout.blocks:
                return tokens.starts[self.file.layout.blocks[at]]
            if at > index and at in self.file.layout.statements:
                break
        return None

    # -- remappings ------------------------------------------------------------------------------------------

    def _remaps(self, component: ComponentDeclaration, node: str) -> dict[str, str]:
        """The names that the program has for topics which its command remaps, by the full names of the topics."""
        found: dict[str, str] = {}
        namespace = node.rpartition("/")[0].strip("/")
        for run in component.runs:
            for own, topic in _remappings(run.command.text):
                full = f"{node}/{topic[2:]}" if topic.startswith("~/") else "/" + resolve_name(namespace, topic)
                found.setdefault(full, own)
        return found


def _edited(text: str, edits: list[tuple[int, int, str]]) -> str:
    """``text`` with the parts between two offsets replaced; of two at one place, the first comes first."""
    for start, end, new in sorted(edits, key=lambda edit: edit[:2], reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _remappings(command: str) -> Iterator[tuple[str, str]]:
    """The remappings of topics in a command: what the program calls the topic, and its name outside."""
    words = _words(command)
    if "--ros-args" in words:
        for option, value in pairwise(words):
            own, separator, topic = value.partition(":=")
            if option in {"-r", "--remap"} and separator and ":" not in own and not own.startswith("__"):
                yield own, topic


def without_remaps(command: str, own: set[str]) -> str:
    """``command`` without its remappings of the topics that the program calls ``own``: their ports state them now."""
    words, kept, at = _words(command), list[str](), 0
    while at < len(words):
        name, separator, _ = words[at + 1].partition(":=") if at + 1 < len(words) else ("", "", "")
        if words[at] in {"-r", "--remap"} and separator and name in own:
            at += 2
            continue
        kept.append(words[at])
        at += 1
    if len(kept) == len(words):
        return command
    if kept and kept[-1] == "--ros-args":
        kept.pop()
    return shlex.join(kept)


def _words(command: str) -> list[str]:
    """The words of a command; none where a quotation is not closed, which `midstride check` reports."""
    try:
        return shlex.split(command)
    except ValueError:
        return []
