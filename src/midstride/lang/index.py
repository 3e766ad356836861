"""The symbols of a system: where each is declared and used.

For editors: go to definition, rename, hover. Names that cannot be resolved are not in the index.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from midstride.lang import syntax
from midstride.lang.declarations import Declarations, NodeEntry, ancestry, resolve_topic
from midstride.lang.source import Source, Span
from midstride.lang.source_files import resolve_name


class Symbol(NamedTuple):
    """A name's meaning.

    ``owner`` is the component of a port, functionality or parameter; for a mode it is ``Component.functionality``.
    """

    kind: str
    name: str
    owner: str = ""


@dataclass(frozen=True, slots=True)
class Occurrence:
    """An occurrence of a symbol. ``namespace`` is that of relative names at this place."""

    symbol: Symbol
    span: Span
    declares: bool = False
    namespace: str = ""


class SymbolIndex:
    """The occurrences of all symbols of a system."""

    def __init__(self, declarations: Declarations) -> None:
        self.declarations = declarations
        self.occurrences = list(self._all())

    def at(self, source: Source, offset: int) -> Occurrence | None:
        """The occurrence at an offset of a source; the position after its last character counts."""
        here = (o for o in self.occurrences if o.span.source.name == source.name)
        return next((o for o in here if o.span.start <= offset <= o.span.end), None)

    def declaration(self, symbol: Symbol) -> Occurrence | None:
        return next((found for found in self.occurrences if found.symbol == symbol and found.declares), None)

    def declared_together(self, symbol: Symbol) -> Iterator[tuple[Symbol, Occurrence]]:
        """The symbols with the same declaration (in a file included in several namespaces), each with its own
        occurrence of it."""
        here = self.declaration(symbol)
        if here is None:
            return
        for found in self.occurrences:
            if found.declares and found.symbol.kind == symbol.kind and found.span == here.span:
                yield found.symbol, found

    def occurrences_of(self, symbol: Symbol) -> list[Occurrence]:
        """The occurrences of a symbol, in source order, each place once."""
        found = {(o.span.source.name, o.span.start): o for o in self.occurrences if o.symbol == symbol}
        return [found[key] for key in sorted(found)]

    def _all(self) -> Iterator[Occurrence]:
        found = self.declarations
        for name, contract in found.contracts.items():
            yield Occurrence(Symbol("contract", name), contract.name.span, True)
            yield from self._contract(contract.contract)
        for resource in found.resources.values():
            yield Occurrence(Symbol("resource", resource.name.text), resource.name.span, True)
            yield from self._host(resource.host)
        for name, host in found.hosts.items():
            yield Occurrence(Symbol("host", name), host.name.span, True)
        for around in found.around:
            yield from self._host(around)
        for name, container in found.containers.items():
            yield Occurrence(Symbol("container", name), container.name.span, True)
            yield from self._host(container.host)
        for name, topic in found.topics.items():
            within = "" if topic.name.text.startswith("/") else name.removesuffix(topic.name.text).strip("/")
            yield Occurrence(Symbol("topic", name), topic.name.span, True, within)
            yield from self._contract(topic.contract)
        for name, (namespace, offer) in found.offers.items():
            yield Occurrence(Symbol("guarantee", name), offer.name.span, True)
            if offer.topic is not None:
                yield self._topic(namespace, offer.topic, None)
            yield from self._contract(offer.contract)
        for component in found.components.values():
            yield from self._component(component)
        for entry in found.nodes.values():
            yield from self._node(entry)
        for namespace, statement in found.constraints:
            if isinstance(statement, (syntax.KeepStatement, syntax.LimitStatement)):
                yield from self._functionality_name(namespace, statement)
            else:
                yield Occurrence(Symbol("node", resolve_name(namespace, statement.first.text)), statement.first.span)
                yield Occurrence(Symbol("node", resolve_name(namespace, statement.then.text)), statement.then.span)

    def _contract(self, expression: syntax.ContractExpression | None) -> Iterator[Occurrence]:
        base = None if expression is None else expression.base
        if base is not None and base.text in self.declarations.contracts:
            yield Occurrence(Symbol("contract", base.text), base.span)

    def _host(self, name: syntax.Name | None) -> Iterator[Occurrence]:
        if name is not None and name.text in self.declarations.hosts:
            yield Occurrence(Symbol("host", name.text), name.span)

    def _topic(self, namespace: str, name: syntax.Name, node: str | None) -> Occurrence:
        return Occurrence(Symbol("topic", resolve_topic(namespace, name.text, node)), name.span, namespace=namespace)

    def _owner(self, component: str, kind: str, name: str) -> str:
        """The component that declares a part: ``component``, or one that it is like."""
        for declared in ancestry(self.declarations.components, component):
            parts: dict[str, set[str]] = {
                "port": {i.name.text for i in declared.inputs} | {o.text for o in declared.outputs},
                "functionality": {f.name.text for f in declared.functionalities},
                "parameter": {p.name.text for p in declared.parameters},
            }
            if name in parts[kind]:
                return declared.name.text
        return component

    def _part(self, component: str, kind: str, name: syntax.Name, declares: bool = False) -> Occurrence:
        owner = component if declares else self._owner(component, kind, name.text)
        return Occurrence(Symbol(kind, name.text, owner), name.span, declares)

    def _component(self, declared: syntax.ComponentDeclaration) -> Iterator[Occurrence]:
        own = declared.name.text
        yield Occurrence(Symbol("component", own), declared.name.span, True)
        if declared.like is not None:
            yield Occurrence(Symbol("component", declared.like.text), declared.like.span)
        for statement in declared.holds:
            for held in statement:
                yield Occurrence(Symbol("resource", held.resource.text), held.resource.span)
        for entry in declared.parameters:
            yield self._part(own, "parameter", entry.name, True)
        for port in declared.inputs:
            yield self._part(own, "port", port.name, True)
            yield from self._contract(port.contract)
        for output in declared.outputs:
            yield self._part(own, "port", output, True)
        for functionality in declared.functionalities:
            yield from self._functionality(own, functionality)

    def _functionality(self, own: str, declared: syntax.FunctionalityDeclaration) -> Iterator[Occurrence]:
        yield self._part(own, "functionality", declared.name, True)
        for port in (*declared.uses, *declared.produces):
            yield self._part(own, "port", port)
        for mode in declared.modes:
            yield Occurrence(Symbol("mode", mode.name.text, f"{own}.{declared.name.text}"), mode.name.span, True)
            for assumed in mode.assumptions:
                yield from self._assumption(own, assumed)
            for entry in mode.parameters:
                yield self._part(own, "parameter", entry.name)
            for guarantee in mode.guarantees:
                yield self._part(own, "port", guarantee.output)
                yield from self._contract(guarantee.contract)

    def _assumption(self, own: str, assumed: syntax.AssumptionExpression) -> Iterator[Occurrence]:
        if isinstance(assumed, syntax.NamedAssumption):
            for name in assumed.inputs:
                yield self._part(own, "port", name)
        elif assumed.base is not None and assumed.base.text in self.declarations.contracts:
            yield from self._contract(assumed)
        elif assumed.base is not None and assumed.is_bare_name:
            yield self._part(own, "port", assumed.base)

    def _node(self, entry: NodeEntry) -> Iterator[Occurrence]:
        declared = entry.declaration
        yield Occurrence(Symbol("node", entry.role), declared.name.span, True)
        if declared.component is None:
            return
        if declared.container is not None:
            name = resolve_name(entry.namespace, declared.container.text)
            yield Occurrence(Symbol("container", name), declared.container.span, namespace=entry.namespace)
        yield from self._host(declared.host)
        for statement in declared.respawn:
            yield from self._host(statement.host)
        fallbacks = (statement.component for statement in declared.respawn)
        for component in filter(None, (declared.component, *fallbacks)):
            yield Occurrence(Symbol("component", component.text), component.span)
        for attachment in declared.attachments:
            yield self._part(declared.component.text, "port", attachment.port)
            for topic in attachment.topics:
                yield self._topic(entry.namespace, topic, declared.name.text)
        for parameter in declared.parameters:
            yield self._part(declared.component.text, "parameter", parameter.name)

    def _functionality_name(
        self, namespace: str, statement: syntax.KeepStatement | syntax.LimitStatement
    ) -> Iterator[Occurrence]:
        role, name = statement.functionality
        yield Occurrence(Symbol("node", resolve_name(namespace, role.text)), role.span)
        entry = self.declarations.nodes.get(resolve_name(namespace, role.text))
        if entry is None or entry.declaration.component is None:
            return
        found = self._part(entry.declaration.component.text, "functionality", name)
        yield found
        if isinstance(statement, syntax.KeepStatement):
            owner = f"{found.symbol.owner}.{name.text}"
            yield Occurrence(Symbol("mode", statement.mode.text, owner), statement.mode.span)
