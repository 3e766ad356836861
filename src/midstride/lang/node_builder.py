"""Builds the model's nodes from their declarations: attachments, parameter values, parameter files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from immutables import Map

from midstride.lang.declarations import MAX_PARTS, Declarations, NodeEntry, ancestry, limited, resolve_topic
from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.parameter_files import SectionInFile, read_sections
from midstride.lang.rcl_parameters import KEY, ParameterValueAt
from midstride.lang.respawn_builder import respawn_policy
from midstride.lang.source import Source, Span
from midstride.lang.source_files import Bounds, FileReader, Unreadable, read_source, shown_path
from midstride.lang.syntax import ComponentDeclaration, Name
from midstride.model.component import ComponentSpec, ParameterSpec, ParameterValue
from midstride.model.near_miss import did_you_mean
from midstride.model.specification import Node


@dataclass(slots=True)
class NodeBuilder:
    """Builds the nodes of a system. ``parameter_spans`` maps (role, parameter) to where the value is given."""

    declarations: Declarations
    components: dict[str, ComponentSpec]
    merged: Mapping[str, ComponentDeclaration]
    read: FileReader
    bounds: Bounds
    reporter: Reporter
    parameter_spans: dict[tuple[str, str], Span] = field(default_factory=dict)
    sources: list[Source] = field(default_factory=list)
    _files: dict[str, list[SectionInFile] | None] = field(default_factory=dict)

    def build(self) -> dict[str, Node]:
        """Every declared node that names a component. Parameters given only in files are added to the components."""
        from_files = {role: self._from_files(entry) for role, entry in self.declarations.nodes.items()}
        self._declare_parameters(from_files)
        entries = self.declarations.nodes.items()
        return {role: self._node(entry, from_files[role]) for role, entry in entries if entry.declaration.component}

    def _node(self, entry: NodeEntry, given: Mapping[str, ParameterValueAt]) -> Node:
        declaration = entry.declaration
        values: dict[str, ParameterValue] = {}
        for name, (value, span) in given.items():
            values[name] = value
            self.parameter_spans[entry.role, name] = span
        own: dict[str, Name] = {}
        for parameter in declaration.parameters:
            name = parameter.name.text
            if name in own:
                note = Note("first set here", own[name].span)
                message = f"duplicate parameter `{name}`"
                self.reporter.report("E007", parameter.name.span, message, help="keep one of them", notes=[note])
                continue
            if parameter.changeable:
                message = "`changeable` belongs in the component, not in a node"
                self.reporter.report("E143", parameter.name.span, message, help=f"write `{name} = …` here")
            own[name] = parameter.name
            values[name] = parameter.value.value
            self.parameter_spans[entry.role, name] = parameter.name.span
        component = "" if declaration.component is None else declaration.component.text
        policy = respawn_policy(declaration.respawn, self.reporter)
        return Node(entry.role, component, self._attachments(entry), Map(values), policy)

    def _attachments(self, entry: NodeEntry) -> Map[str, tuple[str, ...]]:
        declaration = entry.declaration
        component = None if declaration.component is None else self.components.get(declaration.component.text)
        found: dict[str, tuple[str, ...]] = {}
        for attachment in declaration.attachments:
            port = attachment.port.text
            if component is not None and port in (component.inputs if attachment.is_output else component.outputs):
                kind, right = ("input", "<-") if attachment.is_output else ("output", "->")
                message = f"`{port}` of {component.name} is an {kind}"
                help = f"write `{port} {right} {attachment.topics[0].text}`"
                self.reporter.report("E144", attachment.port.span, message, help=help)
            limit = MAX_PARTS - len(found.get(port, ()))
            named = limited(attachment.topics, "topic", lambda topic: topic.span, self.reporter, limit)
            topics = tuple(resolve_topic(entry.namespace, topic.text, declaration.name.text) for topic in named)
            found[port] = found.get(port, ()) + topics
        return Map(found)

    def _from_files(self, entry: NodeEntry) -> dict[str, ParameterValueAt]:
        """The parameters of a node from files: those for all nodes first, then its component's, then its own."""
        given: dict[str, ParameterValueAt] = {}
        for namespace, path in self.declarations.parameter_files:
            if not namespace or entry.role.startswith(f"{namespace}/"):
                self._apply(given, entry.role, self._sections(path), namespace)
        declaration = entry.declaration
        component = None if declaration.component is None else self.merged.get(declaration.component.text)
        for path in component.files if component is not None else ():
            self._apply(given, entry.role, self._sections(path), entry.namespace)
        for path in declaration.files:
            sections = self._sections(path)
            if not self._apply(given, entry.role, sections, entry.namespace) and sections is not None:
                names = [section.pattern for section in sections]
                listed = f"its sections: {', '.join(names[:8])}" if names else f"write `{entry.role}: {KEY}: …`"
                help = did_you_mean(f"/{entry.role}", names) or listed
                message = f"`{path.text}` has no section for {entry.role}"
                self.reporter.report("W160", path.span, message, help=help)
        return given

    def _apply(
        self, given: dict[str, ParameterValueAt], role: str, sections: Iterable[SectionInFile] | None, namespace: str
    ) -> bool:
        matching = [section for section in sections or () if section.matches(role)]
        for section in matching:
            given.update(section.values)
        return bool(matching)

    def _sections(self, path: Name) -> list[SectionInFile] | None:
        try:
            key = self.bounds.path(path, ".yaml", ".yml")
            if key not in self._files:
                self._files[key] = None
                source = read_source(Path(key), self.read, shown_path(path))
                self.sources.append(source)
                self._files[key] = read_sections(source, self.reporter)
            return self._files[key]
        except Unreadable as error:
            message = f"`{path.text}` cannot be read: {error}"
            self.reporter.report(error.code, path.span, message, help=error.help)
            return None

    def _declare_parameters(self, from_files: Mapping[str, Mapping[str, ParameterValueAt]]) -> None:
        """Add the parameters that files give all nodes of a component to it; report those that only some nodes get."""
        users: dict[str, list[str]] = {}
        for role, entry in self.declarations.nodes.items():
            if entry.declaration.component is not None:
                users.setdefault(entry.declaration.component.text, []).append(role)
        for name, roles in users.items():
            if name not in self.components:
                continue
            declared = self.components[name].parameters
            added: dict[str, ParameterSpec] = {}
            partly: dict[tuple[str, str], list[tuple[str, Span]]] = {}
            for role in roles:
                for parameter, (value, span) in from_files[role].items():
                    if parameter in declared or parameter in added:
                        continue
                    lacking = next((other for other in roles if parameter not in from_files[other]), None)
                    if lacking is not None:
                        partly.setdefault((role, lacking), []).append((parameter, span))
                    added[parameter] = ParameterSpec(value)
            for (role, lacking), given in partly.items():
                self._report_partly_given(name, role, lacking, given)
            if added:
                self._extend(name, added)

    def _report_partly_given(self, name: str, role: str, lacking: str, given: list[tuple[str, Span]]) -> None:
        """Report all such parameters at once: the other node's section is missing, or the component's declarations."""
        parameter, span = given[0]
        more = f" (and {len(given) - 1} more)" if len(given) > 1 else ""
        it = "them" if more else "it"
        some = f"parameter `{parameter}`{more} is set for {role} but not for {lacking}"
        message = f"{some}, and {name} declares no value for {it}"
        self.reporter.report("E151", span, message, help=f"declare {it} in component {name}, or set {it} for {lacking}")

    def _extend(self, name: str, added: Mapping[str, ParameterSpec]) -> None:
        """Add the parameters to the components that are like ``name``, which inherit them like declared ones."""
        for other in self.merged:
            if any(ancestor.name.text == name for ancestor in ancestry(self.merged, other)):
                component = self.components[other]
                missing = {key: value for key, value in added.items() if key not in component.parameters}
                self.components[other] = replace(component, parameters=component.parameters.update(missing))
