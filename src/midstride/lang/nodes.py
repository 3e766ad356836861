"""From node declarations to the model's nodes: attachments by full topic names, parameter values, parameter files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from immutables import Map

from midstride.lang.declarations import MAX_PARTS, Declarations, NodeEntry, bounded, topic_name
from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.files import Read, Unreadable, read_source
from midstride.lang.parameter_files import Given, Section, read_sections
from midstride.lang.source import Source, Span
from midstride.lang.syntax import ComponentDeclaration, Name
from midstride.model.component import ComponentSpec, ParameterSpec, ParameterValue
from midstride.model.near_miss import did_you_mean
from midstride.model.specification import Node


class Nodes:
    """Builds the nodes of a system. ``places`` tells where each parameter of each role is given."""

    def __init__(
        self,
        declarations: Declarations,
        components: dict[str, ComponentSpec],
        merged: Mapping[str, ComponentDeclaration],
        read: Read,
        reporter: Reporter,
    ) -> None:
        self.declarations = declarations
        self.components = components
        self.merged = merged
        self.read = read
        self.reporter = reporter
        self.places: dict[tuple[str, str], Span] = {}
        self.sources: list[Source] = []
        self._files: dict[str, list[Section] | None] = {}

    def build(self) -> dict[str, Node]:
        """Every node declared whose component could be read. Components take up the parameters that files alone
        give."""
        from_files = {role: self._from_files(entry) for role, entry in self.declarations.nodes.items()}
        self._declare(from_files)
        entries = self.declarations.nodes.items()
        return {role: self._node(entry, from_files[role]) for role, entry in entries if entry.declaration.component}

    def _node(self, entry: NodeEntry, given: Mapping[str, Given]) -> Node:
        declaration = entry.declaration
        values: dict[str, ParameterValue] = {}
        for name, (value, span) in given.items():
            values[name] = value
            self.places[entry.role, name] = span
        own: dict[str, Name] = {}
        for parameter in declaration.parameters:
            name = parameter.name.text
            if name in own:
                note = Note("the first one is here", own[name].span)
                message = f"there is one parameter `{name}` here already"
                self.reporter.report("E007", parameter.name.span, message, help="keep one of the two", notes=[note])
                continue
            if parameter.changeable:
                message = "whether a parameter is changeable is said in the component"
                self.reporter.report("E143", parameter.name.span, message, help=f"write `{name} = …` alone here")
            own[name] = parameter.name
            values[name] = parameter.value.value
            self.places[entry.role, name] = parameter.name.span
        component = "" if declaration.component is None else declaration.component.text
        return Node(entry.role, component, self._attachments(entry), Map(values))

    def _attachments(self, entry: NodeEntry) -> Map[str, tuple[str, ...]]:
        declaration = entry.declaration
        component = None if declaration.component is None else self.components.get(declaration.component.text)
        found: dict[str, tuple[str, ...]] = {}
        for attachment in declaration.attachments:
            port = attachment.port.text
            if component is not None and port in (component.inputs if attachment.is_output else component.outputs):
                right = "<-" if attachment.is_output else "->"
                kind = "input" if attachment.is_output else "output"
                message = f"`{port}` of {component.name} is an {kind}"
                self.reporter.report(
                    "E144", attachment.port.span, message, help=f"write `{port} {right} {attachment.topics[0].text}`"
                )
            room = MAX_PARTS - len(found.get(port, ()))
            named = bounded(attachment.topics, "topic", lambda topic: topic.span, self.reporter, room)
            topics = tuple(topic_name(entry.namespace, topic.text, declaration.name.text) for topic in named)
            found[port] = found.get(port, ()) + topics
        return Map(found)

    # -- parameter files -----------------------------------------------------------------------------------

    def _from_files(self, entry: NodeEntry) -> dict[str, Given]:
        """What parameter files give a node: those for everyone first, then its component's, then its own."""
        given: dict[str, Given] = {}
        for namespace, path in self.declarations.parameter_files:
            if not namespace or entry.role.startswith(f"{namespace}/"):
                self._take(given, entry.role, self._sections(path), namespace)
        declaration = entry.declaration
        component = None if declaration.component is None else self.merged.get(declaration.component.text)
        for path in component.files if component is not None else ():
            self._take(given, entry.role, self._sections(path), entry.namespace)
        for path in declaration.files:
            sections = self._sections(path)
            if not self._take(given, entry.role, sections, entry.namespace) and sections is not None:
                names = [section.pattern for section in sections]
                help = did_you_mean(f"/{entry.role}", names) or f"its sections: {', '.join(names[:8])}"
                message = f"`{path.text}` has no section for {entry.role}"
                self.reporter.report("W160", path.span, message, help=help)
        return given

    def _take(self, given: dict[str, Given], role: str, sections: Iterable[Section] | None, namespace: str) -> bool:
        matching = [section for section in sections or () if section.matches(role, namespace)]
        for section in matching:
            given.update(section.values)
        return bool(matching)

    def _sections(self, path: Name) -> list[Section] | None:
        base = path.span.source.path
        folder = Path() if base is None else base.parent
        key = os.path.normpath(folder / path.text) if path.text and "\0" not in path.text else ""
        if key not in self._files:
            self._files[key] = self._read_file(key, path)
        return self._files[key]

    def _read_file(self, key: str, path: Name) -> list[Section] | None:
        shown = key
        if not os.path.isabs(path.text):
            shown = os.path.normpath(os.path.join(os.path.dirname(path.span.source.name), path.text))
        try:
            if not key:
                raise Unreadable("E100", "this names no file")
            source = read_source(Path(key), self.read, shown)
        except Unreadable as error:
            message = f"`{path.text}` cannot be read: {error}"
            self.reporter.report(error.code, path.span, message, help=error.help)
            return None
        self.sources.append(source)
        return read_sections(source, self.reporter)

    def _declare(self, from_files: Mapping[str, Mapping[str, Given]]) -> None:
        """Let each component declare what files give all of its nodes; what only some of them get needs a default."""
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
                self._given_to_some(name, role, lacking, given)
            if added:
                self._extend(name, added)

    def _given_to_some(self, name: str, role: str, lacking: str, given: list[tuple[str, Span]]) -> None:
        """One mistake, one message: it is the other node's section that is missing, or the component's declarations."""
        parameter, span = given[0]
        more = f" (and {len(given) - 1} more)" if len(given) > 1 else ""
        it = "them" if more else "it"
        some = f"parameter `{parameter}`{more} is given for {role}, but not for {lacking}"
        message = f"{some}, and {name} declares no value for {it}"
        self.reporter.report("E151", span, message, help=f"declare {it} in component {name}, or give {it} to {lacking}")

    def _extend(self, name: str, added: Mapping[str, ParameterSpec]) -> None:
        """Components that are like ``name`` take the parameters over, as they take over declared ones."""
        for other, declaration in self.merged.items():
            if other == name or self._is_like(declaration, name):
                component = self.components[other]
                missing = {key: value for key, value in added.items() if key not in component.parameters}
                self.components[other] = replace(component, parameters=component.parameters.update(missing))

    def _is_like(self, declaration: ComponentDeclaration, name: str) -> bool:
        seen: set[str] = set()
        while (
            declaration.like is not None and declaration.like.text in self.merged and declaration.like.text not in seen
        ):
            if declaration.like.text == name:
                return True
            seen.add(declaration.like.text)
            declaration = self.merged[declaration.like.text]
        return False
