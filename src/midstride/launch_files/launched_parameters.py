"""The parameters of a launched node: which files the specification names, and which values it states."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.parameter_files import SectionInFile, read_sections
from midstride.lang.source import Source, Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import ParametersGiven
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launched_nodes import LaunchedNode
from midstride.model.component import ParameterValue

# What rcl takes for the name of a parameter in `-p NAME:=VALUE`.
_RULE: Final = re.compile(r"(?:(?P<node>[A-Za-z_/~*][\w/~*]*):)?(?P<name>[A-Za-z_][\w./]*):=(?P<value>.*)", re.DOTALL)


@dataclass(slots=True)
class LaunchedParameters:
    """What a node has: the ``files`` that are named, by their paths, values that they do not have, and values that
    replace theirs. ``effective``: all of its values."""

    files: list[str] = field(default_factory=list)
    values: dict[str, ParameterValue] = field(default_factory=dict)
    replaced: dict[str, ParameterValue] = field(default_factory=dict)
    effective: dict[str, ParameterValue] = field(default_factory=dict)


def written_file(section: str, values: Mapping[str, Any]) -> str:
    """A parameter file with one section, as launch writes it."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    return str(yaml.safe_dump({section: {"ros__parameters": dict(values)}}, allow_unicode=True, width=100_000))


class ParameterReader:
    """Reads parameter files, each once. ``may_name``: whether the specification may name the file at a path."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings, may_name: Callable[[str], bool]) -> None:
        self._files = files
        self._findings = findings
        self._may_name = may_name
        self._sections: dict[tuple[str, str | None], list[SectionInFile] | None] = {}
        self._files_read: dict[str, tuple[Span, list[SectionInFile], bool]] = {}

    def parameters(self, node: LaunchedNode) -> LaunchedParameters:
        """What ROS gives the node: of the sections that apply to it, in the order in which each is first met, the last.

        A file is named if the specification may read it; another one is stated by the values that it has for this node.
        """
        read = [(given, sections) for given in node.settings if (sections := self._read(given, node)) is not None]
        effective = _effective((section for _, sections in read for section in sections), node.role)
        for name in [name for name, value in effective.items() if value == []]:
            del effective[name]
            message = f"the parameter `{name}` of `{node.role}` is left out: an empty list has no type in ROS"
            self._findings.add("parameters", message, node.span)
        named = [
            (given.path, sections)
            for given, sections in read
            if given.path is not None and given.text is None and self._may_name(given.path)
        ]
        of_files: dict[str, ParameterValue] = {}
        for _, sections in named:
            for section in sections:
                if section.matches(node.role):
                    of_files |= {name: value for name, (value, _) in section.values.items()}
        for given, sections in read:
            if given.path is not None:
                is_named = any(given.path == path for path, _ in named)
                self._files_read.setdefault(given.path, (given.span, sections, is_named))
        return LaunchedParameters(
            list(dict.fromkeys(path for path, _ in named)),
            {name: value for name, value in effective.items() if name not in of_files},
            {name: value for name, value in effective.items() if name in of_files and not _same(value, of_files[name])},
            effective,
        )

    def note_other_sections(self, nodes: Sequence[LaunchedNode]) -> None:
        """Name the sections of files that apply to no node of the specification.

        One with the name of a node, but another namespace, is a mistake that ROS does not report. Others may be for
        further nodes in the processes; they are left out where the specification does not name their file.
        """
        for path, (span, sections, is_named) in self._files_read.items():
            name = os.path.basename(path)
            lost = [section.pattern for section in sections if not any(section.matches(node.role) for node in nodes)]
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

    def _read(self, given: ParametersGiven, node: LaunchedNode) -> list[SectionInFile] | None:
        if given.rule is not None:
            return self._of_rule(given.rule, given.span, node)
        key = given.path or "", given.text
        if key not in self._sections:
            self._sections[key] = self._of_file(given)
        return self._sections[key]

    def _of_rule(self, rule: str, span: Span, node: LaunchedNode) -> list[SectionInFile] | None:
        match = _RULE.fullmatch(rule)
        if match is not None:
            section = "/**" if match["node"] is None else match["node"]
            value = match["value"].removesuffix("\n").removesuffix("\n...")  # as PyYAML ends a plain value
            indented = value.replace("\n", "\n      ")
            text = f"{json.dumps(section)}:\n  ros__parameters:\n    {json.dumps(match['name'])}: {indented}\n"
            reporter = Reporter()
            sections = read_sections(Source("-p", text), reporter)
            if not reporter.has_errors:
                return sections
        message = f"launch passes `-p {shortened(rule)}` to `{node.role}`, which ROS refuses; the parameter is left out"
        self._findings.add("parameters", message, span)
        return None

    def _of_file(self, given: ParametersGiven) -> list[SectionInFile] | None:
        name = "parameters" if given.path is None else os.path.basename(given.path)
        if given.text is not None:
            source = Source(name, given.text)
        else:
            assert given.path is not None
            try:
                source = self._files.source(given.path, ".yaml", ".yml")
            except UnknownValue as error:
                self._findings.add("parameters", f"the parameter file `{name}` is left out: {error}", given.span)
                return None
        reporter = Reporter()
        sections = read_sections(source, reporter)
        if not reporter.has_errors:
            return sections
        if given.path is None:
            message = "parameters are left out: ROS refuses the file that launch writes for them"
        else:
            line = reporter.found[0].position[0]
            message = f"`{name}` is left out: line {line} is not of a parameter file that can be read"
        self._findings.add("parameters", message, given.span)
        return None


def _effective(sections: Iterable[SectionInFile], role: str) -> dict[str, ParameterValue]:
    """The values of a node, as rcl and rclcpp have them after all sections were read."""
    merged: dict[str, list[SectionInFile]] = {}
    for section in sections:
        merged.setdefault(section.pattern, []).append(section)
    values: dict[str, ParameterValue] = {}
    for parts in merged.values():
        if parts[0].matches(role):
            for section in parts:
                values |= {name: value for name, (value, _) in section.values.items()}
    return values


def _same(first: ParameterValue, second: ParameterValue) -> bool:
    return type(first) is type(second) and repr(first) == repr(second)
