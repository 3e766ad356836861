"""The parameters of a launched node: which files the specification names, and which values it states."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.parameter_files import SectionInFile, read_sections, sections_of
from midstride.lang.rcl_parameters import ParameterValueAt
from midstride.lang.source import Source, Span
from midstride.lang.yaml_events import InvalidYaml
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.component_parameters import flat, launched_values
from midstride.launch_files.context import ParametersGiven
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launched_nodes import LaunchedNode
from midstride.model.component import ROS_PARAMETERS, ParameterValue

# The section of all nodes of a process.
FOR_ALL: Final = "/**"
# What rcl takes for the name of a parameter in `-p NAME:=VALUE`.
_RULE: Final = re.compile(r"(?:(?P<node>[A-Za-z_/~*][\w/~*]*):)?(?P<name>[A-Za-z_][\w./]*):=(?P<value>.*)", re.DOTALL)


@dataclass(slots=True)
class LaunchedParameters:
    """The parameters of a node: ``statements`` in order, ``values`` that these do not have, and ``replaced`` ones.

    A statement is the path of a file that is named, or has values for all nodes of the process. ``effective``: all of
    the node's values.
    """

    statements: list[str | dict[str, ParameterValue]] = field(default_factory=list)
    values: dict[str, ParameterValue] = field(default_factory=dict)
    replaced: dict[str, ParameterValue] = field(default_factory=dict)
    effective: dict[str, ParameterValue] = field(default_factory=dict)


class _Read(NamedTuple):
    """A parameter file, or what comes to one, and its sections."""

    source: Source
    sections: list[SectionInFile]


def written_file(section: str, values: Mapping[str, Any]) -> str:
    """A parameter file with one section, as launch writes it: with nested values under dotted names."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    return str(yaml.safe_dump({section: {"ros__parameters": dict(flat(values))}}, allow_unicode=True, width=100_000))


class ParameterReader:
    """Reads parameter files, each once. ``may_name``: whether the specification may name the file at a path."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings, may_name: Callable[[str], bool]) -> None:
        self._files = files
        self._findings = findings
        self._may_name = may_name
        self._sections: dict[tuple[str, str | None], _Read | str] = {}
        self._files_read: dict[str, tuple[Span, list[SectionInFile], bool]] = {}
        # By node: what launch gives to its process.
        self._given: dict[str, list[tuple[ParametersGiven, _Read]]] = {}

    def parameters(self, node: LaunchedNode) -> LaunchedParameters:
        """The parameters that ROS gives the node: of the sections that apply to it, in the order in which each is
        first met, the last.

        A file is named if the specification may read it; another one is stated by the values that it has for this node.
        """
        read = [(given, found) for given in node.settings if (found := self._read(given, node)) is not None]
        self._given[node.role] = read
        effective = self._effective([found for _, found in read], node, node.launched_role or None)
        if node.container is not None:
            self._note_other_values(node, read, effective)
        for name in [name for name, value in effective.items() if value == []]:
            del effective[name]
            message = f"the parameter `{name}` of `{node.role}` is left out: an empty list has no type in ROS"
            self._findings.add("parameters", message, node.span)
        statements, of_statements = self._statements(read, node, effective)
        for given, found in read:
            if given.path is not None:
                self._files_read.setdefault(given.path, (given.span, found.sections, given.path in statements))
        return LaunchedParameters(
            statements,
            {name: value for name, value in effective.items() if name not in of_statements},
            {
                name: value
                for name, value in effective.items()
                if name in of_statements and not _same(value, of_statements[name])
            },
            effective,
        )

    def _statements(
        self,
        read: Sequence[tuple[ParametersGiven, _Read]],
        node: LaunchedNode,
        effective: Mapping[str, ParameterValue],
    ) -> tuple[list[str | dict[str, ParameterValue]], dict[str, ParameterValue]]:
        """The files that are named and the values for all nodes of the process, in their order; what the node has of
        these, since of statements of the language the later one wins.

        Values for all nodes are not among them for a node without a name, whose own ones are for all, and for the time;
        nor those of another type than the node's own, which the language has not.
        """
        for_all: list[dict[str, ParameterValue]] = []
        last: dict[str, int] = {}
        for number, (given, found) in enumerate(read):
            sections = () if node.unnamed or self._is_named(given) else found.sections
            for_all.append(
                {
                    name: value.value
                    for section in sections
                    for name, value in section.values.items()
                    if section.pattern == FOR_ALL
                    and name not in ROS_PARAMETERS
                    and name in effective
                    and _type_of(value.value) == _type_of(effective[name])
                }
            )
            last |= dict.fromkeys(for_all[-1], number)
        statements: list[str | dict[str, ParameterValue]] = []
        values: dict[str, ParameterValue] = {}
        files: list[_Read] = []
        for number, (given, found) in enumerate(read):
            if self._is_named(given) and given.path not in statements:
                assert given.path is not None
                statements.append(given.path)
                files.append(found)
            stated = {name: value for name, value in for_all[number].items() if last[name] == number}
            if stated:
                values |= self._effective(files, node) | stated
                files = []
                if statements and isinstance(statements[-1], dict):
                    statements[-1] |= stated
                else:
                    statements.append(stated)
        return statements, values | self._effective(files, node)

    def _note_other_values(
        self, node: LaunchedNode, read: Sequence[tuple[ParametersGiven, _Read]], effective: Mapping[str, ParameterValue]
    ) -> None:
        """Name the parameters that launch gives a composable node otherwise than ROS gives them to a node."""
        launched: dict[str, ParameterValue] = {}
        role = "" if node.unnamed else node.launched_role or node.role
        try:
            for given, found in read:
                launched |= launched_values(given, found.source.text, role)
        except ValueError:
            message = f"launch cannot read the parameters of the component `{node.role}`; here ROS's reading is taken"
            self._findings.add("parameters", message, node.span, left_out=False)
            return
        for name in sorted({*launched, *effective}):
            if name in launched and name in effective and _same(launched[name], effective[name]):
                continue
            there, here = (repr(each[name]) if name in each else "no value" for each in (launched, effective))
            message = (
                f"launch gives the parameter `{name}` of the component `{node.role}` {shortened(there)}, and here it "
                f"has {shortened(here)}, as a node would: launch reads the parameters of components by itself; state "
                "which one is meant in its `parameters`"
            )
            self._findings.add("parameters", message, node.span, left_out=False)

    def _is_named(self, given: ParametersGiven) -> bool:
        return given.path is not None and given.text is None and self._may_name(given.path)

    def _effective(
        self, read: Sequence[_Read], node: LaunchedNode, other: str | None = None
    ) -> dict[str, ParameterValue]:
        """The values of a node, or of an ``other`` one in its process, as rcl and rclcpp have them after all sections
        were read."""
        role = node.role if other is None else other
        merged: dict[str, list[SectionInFile]] = {}
        for section in (section for found in read for section in found.sections):
            merged.setdefault(section.pattern, []).append(section)
        if any(_overlap(parts) for parts in merged.values()):  # rcl keeps values of several types under one name
            try:
                merged = {section.pattern: [section] for section in sections_of([found.source for found in read])}
            except InvalidYaml as refused:
                message = f"ROS refuses the parameters of `{role}`, which are read one after the other: {refused}"
                self._findings.add("parameters", message, node.span, left_out=False)
        values: dict[str, ParameterValue] = {}
        for parts in merged.values():
            if parts[0].matches(role):
                for section in parts:
                    values |= {name: value for name, (value, _) in section.values.items()}
        return values

    def note_other_sections(self, nodes: Sequence[LaunchedNode]) -> None:
        """Name the sections of files that apply to no node of the specification.

        One with the name of a node, but another namespace, is a mistake that ROS does not report. Others may be for
        further nodes in the processes; they are left out where the specification does not name their file.
        """
        for path, (span, sections, is_named) in self._files_read.items():
            name = os.path.basename(path)
            roles = [node.launched_role or node.role for node in nodes]
            lost = [section.pattern for section in sections if not any(map(section.matches, roles))]
            of_others = []
            for pattern in dict.fromkeys(lost):
                meant = [node.role for node in nodes if f"/{node.role}".endswith(f"/{pattern.strip('/')}")]
                if meant:
                    message = (
                        f"in `{name}`, the section `{pattern}` is for the node `/{pattern.strip('/')}`; ROS does not "
                        f"give it to `/{meant[0]}`: write `/{meant[0]}:` or `/**/{meant[0].rpartition('/')[2]}:`"
                    )
                    self._findings.add("parameters", message, span, left_out=False)
                else:
                    of_others.append(pattern)
            if of_others and not is_named:
                few = ", ".join(f"`{each}`" for each in of_others[:4]) + (", …" if len(of_others) > 4 else "")
                folder = shlex.quote(os.path.dirname(os.path.realpath(path)))
                remedy = f"to name the file itself, allow its folder: `midstride --include-path {folder} import …`"
                what = f"of `{name}`, what is for no node named here ({few}) is left out"
                self._findings.add("parameters", f"{what}; {remedy}", span)

    def note_values_for_all(
        self,
        node: LaunchedNode,
        statements: Sequence[str | Mapping[str, ParameterValue]],
        nodes: Sequence[LaunchedNode],
    ) -> None:
        """Name what further nodes of a process have with launch and not with the ``statements`` of the specification,
        where files show that there may be some."""
        if node.unnamed:
            return
        given = self._given[node.role]
        for_all = {
            name
            for each, found in given
            if not self._is_named(each)
            for section in found.sections
            if section.pattern == FOR_ALL
            for name in section.values
        }
        of_files = {each.path: found for each, found in given if self._is_named(each)}
        stated = [of_files[each] if isinstance(each, str) else _stated(FOR_ALL, each, node.span) for each in statements]
        names, others = [], []
        for section in (section for each, found in given if each.path is not None for section in found.sections):
            role = section.pattern.strip("/")
            if "*" in role or any(
                section.matches(other.role) or f"/{other.role}".endswith(f"/{role}") for other in nodes
            ):
                continue
            here, there = (
                self._effective(stated, node, role),
                self._effective([found for _, found in given], node, role),
            )
            different = [
                name
                for name in for_all
                if name not in ROS_PARAMETERS
                and name in there
                and not (name in here and _same(there[name], here[name]))
            ]
            if different:
                names += sorted(different)
                others.append(section.pattern)
        if names:
            few, further = (
                ", ".join(f"`{each}`" for each in list(dict.fromkeys(them))[:4]) for them in (names, others)
            )
            message = (
                f"launch gives {few} to all nodes of the process of `{node.role}`, here that node alone has it: if "
                f"{further} is in this process, state it there too, in a section of a parameter file"
            )
            self._findings.add("parameters", message, node.span, left_out=False)

    def _read(self, given: ParametersGiven, node: LaunchedNode) -> _Read | None:
        if given.values is not None:
            return _stated(f"/{node.launched_role or node.role}", given.values, given.span)
        if given.rule is not None:
            return self._of_rule(given.rule, given.span, node)
        key = given.path or "", given.text
        if key not in self._sections:
            self._sections[key] = self._of_file(given)
        found = self._sections[key]
        if isinstance(found, str):
            self._findings.add("parameters", f"{found} (of `{node.role}`)", given.span)
            return None
        return found

    def _of_rule(self, rule: str, span: Span, node: LaunchedNode) -> _Read | None:
        match = _RULE.fullmatch(rule)
        if match is not None:
            section = "/**" if match["node"] is None else match["node"]
            value = match["value"].removesuffix("\n").removesuffix("\n...")  # as PyYAML ends a plain value
            indented = value.replace("\n", "\n      ")
            text = f"{json.dumps(section)}:\n  ros__parameters:\n    {json.dumps(match['name'])}: {indented}\n"
            reporter = Reporter()
            source = Source("-p", text)
            sections = read_sections(source, reporter)
            # rcl takes a mapping in a file, but not as the value of one parameter.
            if sections is not None and all(list(each.values) == [match["name"]] for each in sections):
                return _Read(source, sections)
        message = f"launch passes `-p {shortened(rule)}` to `{node.role}`, which ROS refuses; the parameter is left out"
        self._findings.add("parameters", message, span)
        return None

    def _of_file(self, given: ParametersGiven) -> _Read | str:
        """Return the parameters of a file, or why it is left out, in words."""
        name = "parameters" if given.path is None else os.path.basename(given.path)
        if given.text is not None:
            source = Source(name, given.text)
        else:
            assert given.path is not None
            try:
                source = self._files.source(given.path, ".yaml", ".yml")
            except UnknownValue as error:
                return f"the parameter file `{name}` is left out: {error}"
        reporter = Reporter()
        sections = read_sections(source, reporter)
        if sections is not None:
            return _Read(source, sections)
        refused = reporter.found[0]
        if given.path is None:
            return f"the file that launch writes is left out, as ROS refuses it: {refused.message}"
        return f"`{name}` is left out: line {refused.position[0]} is not of a parameter file that can be read"


def _stated(pattern: str, values: Mapping[str, ParameterValue], span: Span) -> _Read:
    """The equivalent of a parameter file with values for the nodes that ``pattern`` matches."""
    section = SectionInFile(pattern, span, {name: ParameterValueAt(value, span) for name, value in values.items()})
    return _Read(Source("parameters", written_file(pattern, values)), [section])


def _overlap(parts: Sequence[SectionInFile]) -> bool:
    """Return whether two sections state the same parameter, or one that is nested in a parameter of the other."""
    seen: set[str] = set()
    for section in parts:
        names = {name.partition(".")[0] for name in section.values}
        if not seen.isdisjoint(names):
            return True
        seen |= names
    return False


def _type_of(value: ParameterValue) -> tuple[type, ...]:
    return (list, *{type(each) for each in value}) if isinstance(value, list) else (type(value),)


def _same(first: ParameterValue, second: ParameterValue) -> bool:
    return type(first) is type(second) and repr(first) == repr(second)
