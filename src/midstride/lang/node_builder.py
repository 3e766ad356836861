"""Builds the model's nodes from their declarations: attachments, parameter values, parameter files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from immutables import Map

from midstride.lang.component_builder import report_for_all
from midstride.lang.declarations import MAX_PARTS, Declarations, NodeEntry, ancestry, host_of, limited, resolve_topic
from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.parameter_files import SectionInFile, read_sections, sections_of
from midstride.lang.rcl_parameters import KEY, ParameterValueAt
from midstride.lang.respawn_builder import respawn_policy
from midstride.lang.source import Source, Span
from midstride.lang.source_files import (
    Bounds,
    FileReader,
    Unreadable,
    hint_for_missing,
    read_source,
    resolve_name,
    shown_path,
)
from midstride.lang.syntax import ComponentDeclaration, Name, ParameterEntry
from midstride.lang.yaml_events import InvalidYaml
from midstride.model.component import ROS_PARAMETERS, ComponentSpec, ParameterSection, ParameterSpec, ParameterValue
from midstride.model.near_miss import did_you_mean
from midstride.model.specification import Node

# The section of all nodes.
_ALL: Final = "/**"


@dataclass(slots=True)
class _Stated:
    """The statements for the parameters of one role, statement by statement: the later one takes precedence.

    ``values``: for the role, but for the defaults of its component. ``of_files``: those of files among them, whatever
    is stated after them. ``sections``: what files have for all nodes, by the names of their sections. ``foreign``: its
    program does not use Midstride's API, so it may have further nodes.
    """

    role: str
    sections_of_files: Callable[[tuple[str, ...]], Sequence[SectionInFile]]
    values: dict[str, ParameterValueAt] = field(default_factory=dict)
    of_files: dict[str, ParameterValueAt] = field(default_factory=dict)
    sections: dict[str, dict[str, ParameterValue]] = field(default_factory=dict)
    unnamed: bool = False
    foreign: bool = False
    _run: tuple[str, ...] = ()

    def file(self, key: str) -> None:
        """Files that follow one another are read as ROS reads several `--params-file`."""
        self._run = (*self._run, key)

    def value(self, name: str, value: ParameterValueAt | None) -> None:
        """Without a value, that of the component."""
        self.end()
        self.values.pop(name, None)
        if value is not None:
            self.values[name] = value

    def for_all(self, name: str, value: ParameterValueAt) -> None:
        """A value that further nodes of the process have as well, as launch gives it to them."""
        self.end()
        self.sections.setdefault(_ALL, {})[name] = value.value

    def value_for_all(self, name: str, value: ParameterValueAt) -> None:
        """A value of a node whose name is not known: as in launch, it is for all nodes of the process."""
        self.for_all(name, value)
        self.values[name] = value

    def end(self) -> None:
        """No file follows at once."""
        for section in self.sections_of_files(self._run) if self._run else ():
            if section.matches(self.role) and not self.unnamed:
                self.values |= section.values
                self.of_files |= section.values
            values = {name: each.value for name, each in section.values.items()}
            self.sections.setdefault(section.pattern, {}).update(values)
        self._run = ()


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
    _files: dict[str, tuple[Source, list[SectionInFile]] | None] = field(default_factory=dict)
    _runs: dict[tuple[str, ...], list[SectionInFile]] = field(default_factory=dict)

    def build(self) -> dict[str, Node]:
        """Every declared node that names a component. Parameters given only in files are added to the components."""
        stated = {role: self._stated(entry) for role, entry in self.declarations.nodes.items()}
        self._declare_parameters({role: each.of_files for role, each in stated.items()})
        entries = self.declarations.nodes.items()
        return {role: self._node(entry, stated[role]) for role, entry in entries if entry.declaration.component}

    def _node(self, entry: NodeEntry, stated: _Stated) -> Node:
        declaration = entry.declaration
        name = "" if declaration.component is None else declaration.component.text
        component = self.components.get(name)
        own: dict[str, Name] = {}
        for parameter in declaration.parameters:
            text = parameter.name.text
            if text in own:
                note = Note("first set here", own[text].span)
                message = f"duplicate parameter `{text}`"
                self.reporter.report("E007", parameter.name.span, message, help="keep one of them", notes=[note])
                continue
            if parameter.changeable:
                message = "`changeable` belongs in the component, not in a node"
                self.reporter.report("E143", parameter.name.span, message, help=f"write `{text} = …` here")
            if parameter.for_all and component is not None and component.gate is None:
                report_for_all(parameter.name, name, self.reporter)
            own[text] = parameter.name
            known = component is None or component.gate is None or text in {*component.parameters, *ROS_PARAMETERS}
            if component is not None and not known and text not in stated.of_files:
                message = f"{name} has no parameter `{text}`"
                help = did_you_mean(text, component.parameters)
                help = help or f"declare it in {name}: `parameters {{ {text} = … }}`"
                self.reporter.report("E008", parameter.name.span, message, help=help)
        for text, each in stated.values.items():
            self.parameter_spans[entry.role, text] = each.span
        sections = () if component is None or component.gate is None else tuple(self._other_sections(stated))
        policy = respawn_policy(declaration.respawn, self.reporter)
        values = Map({text: each.value for text, each in stated.values.items()})
        container = None if (inside := declaration.container) is None else resolve_name(entry.namespace, inside.text)
        attachments, host = self._attachments(entry), self._host(declaration.host, container)
        return Node(entry.role, name, attachments, values, policy, sections, container, host)

    def _host(self, stated: Name | None, container: str | None) -> str:
        """The host of a node: the one that is stated for it, else that of its container."""
        if stated is None and container in self.declarations.containers:
            stated = self.declarations.containers[container].host
        return host_of(stated)

    def _other_sections(self, stated: _Stated) -> Iterator[ParameterSection]:
        """The sections that a further node in the process may read, which is none of the system's own nodes.

        What a node is called that its program names is not known here: it may have its own name, or any other.
        """
        for pattern, values in stated.sections.items():
            if values and not self._is_named(pattern.strip("/")):
                yield ParameterSection(pattern, Map(values))

    def _is_named(self, role: str) -> bool:
        """Return whether the system has a node ``role`` that is passed this name."""
        entry = self.declarations.nodes.get(role)
        if entry is None:
            return False
        component = None if entry.declaration.component is None else entry.declaration.component.text
        return component not in self.components or not self.components[component].unnamed

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

    def _stated(self, entry: NodeEntry) -> _Stated:
        """Return what is stated for a node: in files for all nodes first, then in its component, then in itself.

        What a component states before its first file is a default, and comes before all files.
        """
        name = "" if entry.declaration.component is None else entry.declaration.component.text
        unnamed = name in self.components and self.components[name].unnamed
        found = _Stated(entry.role, self._sections_of_run, unnamed=unnamed)
        declaration = entry.declaration
        component = self.merged.get(name)
        found.foreign = name in self.components and self.components[name].gate is not None
        for parameter in component.parameters if component is not None else ():
            if not parameter.after and unnamed:
                found.value_for_all(parameter.name.text, self._at(parameter))
            elif not parameter.after and found.foreign and _is_for_all(parameter):
                found.for_all(parameter.name.text, self._at(parameter))
        for namespace, path in self.declarations.parameter_files:
            if not namespace or entry.role.startswith(f"{namespace}/"):
                self._add_file(found, path)
        if component is not None:
            entries = [(each, self._at(each)) for each in component.parameters if each.after]
            self._add(found, component.files, entries, defaults=True)
        own: dict[str, tuple[ParameterEntry, ParameterValueAt]] = {}
        for parameter in declaration.parameters:
            own.setdefault(parameter.name.text, (parameter, self._at(parameter)))
        self._add(found, declaration.files, list(own.values()), named=not unnamed)
        found.end()
        for text, value in found.sections.get(_ALL, {}).items() if unnamed else ():
            if text in found.values:  # a later file may have another one
                found.values[text] = found.values[text]._replace(value=value)
        return found

    def _at(self, entry: ParameterEntry) -> ParameterValueAt:
        return ParameterValueAt(entry.value.value, entry.name.span)

    def _add(
        self,
        found: _Stated,
        files: Sequence[Name],
        entries: Sequence[tuple[ParameterEntry, ParameterValueAt]],
        named: bool = False,
        defaults: bool = False,
    ) -> None:
        """The files and values of one declaration, in their order.

        ``named``: each file is for this node; ``defaults``: the values are those of the component anyway.
        """
        for index in range(len(files) + 1):
            if index:
                self._add_file(found, files[index - 1], named)
            for parameter, value in entries:
                if parameter.after == index and found.unnamed:
                    found.value_for_all(parameter.name.text, value)
                elif parameter.after == index:
                    found.value(parameter.name.text, None if defaults else value)
                    if found.foreign and _is_for_all(parameter):
                        found.for_all(parameter.name.text, value)

    def _add_file(self, found: _Stated, path: Name, named: bool = False) -> None:
        key = None
        try:
            key = self.bounds.path(path, ".yaml", ".yml")
            if key not in self._files:
                self._files[key] = None
                source = read_source(Path(key), self.read, shown_path(path))
                self.sources.append(source)
                sections = read_sections(source, self.reporter)
                self._files[key] = None if sections is None else (source, sections)
        except Unreadable as error:
            message = f"`{path.text}` cannot be read: {error}"
            help = error.help or (None if key is None else hint_for_missing(key, path))
            self.reporter.report(error.code, path.span, message, help=help)
            return
        if (file := self._files[key]) is None:
            return
        found.file(key)
        if named and not any(section.matches(found.role) for section in file[1]):
            names = [section.pattern for section in file[1]]
            listed = f"its sections: {', '.join(names[:8])}" if names else f"write `{found.role}: {KEY}: …`"
            help = did_you_mean(f"/{found.role}", names) or listed
            message = f"`{path.text}` has no section for {found.role}"
            self.reporter.report("W160", path.span, message, help=help)

    def _sections_of_run(self, keys: tuple[str, ...]) -> list[SectionInFile]:
        if keys not in self._runs:
            read = [file for key in keys if (file := self._files[key]) is not None]
            try:
                self._runs[keys] = read[0][1] if len(read) == 1 else sections_of([source for source, _ in read])
            except InvalidYaml as refused:  # each can be read alone
                self.reporter.report("E150", refused.span, str(refused), help=refused.help)
                self._runs[keys] = []
        return self._runs[keys]

    def _declare_parameters(self, from_files: Mapping[str, Mapping[str, ParameterValueAt]]) -> None:
        """Add the parameters that files give all nodes of a component to it; report those that only some nodes get."""
        users: dict[str, list[str]] = {}
        for role, entry in self.declarations.nodes.items():
            if entry.declaration.component is not None:
                users.setdefault(entry.declaration.component.text, []).append(role)
        for name, roles in users.items():
            if name not in self.components:
                continue
            declared, gate = self.components[name].parameters, self.components[name].gate
            added: dict[str, ParameterSpec] = {}
            partly: dict[tuple[str, str], list[tuple[str, Span]]] = {}
            for role in roles:
                for parameter, (value, span) in from_files[role].items():
                    if parameter in declared or parameter in added:
                        continue
                    lacking = next((other for other in roles if parameter not in from_files[other]), None)
                    if lacking is not None and gate is not None:
                        continue  # the program declares its parameters itself
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


def _is_for_all(entry: ParameterEntry) -> bool:
    """Return whether a value is for all nodes of the process, as that of its time is, which is one."""
    return entry.for_all or entry.name.text in ROS_PARAMETERS
