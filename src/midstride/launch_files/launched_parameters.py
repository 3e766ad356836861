"""The parameters of a launched node: which files the specification names, and which values it states."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.parameter_files import SectionInFile, read_sections
from midstride.lang.source import Source
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import ParameterFileName
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launched_nodes import LaunchedNode
from midstride.model.component import ParameterValue


@dataclass(slots=True)
class LaunchedParameters:
    """``files`` are paths; ``values`` take precedence over them."""

    files: list[str] = field(default_factory=list)
    values: dict[str, ParameterValue] = field(default_factory=dict)


class ParameterReader:
    """Reads parameter files, each once. ``may_name``: whether the specification may name the file at a path."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings, may_name: Callable[[str], bool]) -> None:
        self._files = files
        self._findings = findings
        self._may_name = may_name
        self._sections: dict[str, list[SectionInFile] | None] = {}

    def parameters(self, node: LaunchedNode) -> LaunchedParameters:
        """A file that may not be named, or that comes after a value, is stated by its values for this node."""
        found = LaunchedParameters()
        for setting in node.settings:
            if isinstance(setting, tuple):
                name, value = setting
                found.values[name] = value
                continue
            sections = self._read(setting)
            if sections is None:
                continue
            if setting.text is None and not found.values and self._may_name(setting.path):
                found.files.append(setting.path)
                continue
            for section in sections:
                if section.matches(node.role):
                    found.values |= {name: value for name, (value, _) in section.values.items()}
        return found

    def _read(self, file: ParameterFileName) -> list[SectionInFile] | None:
        if file.text is not None:
            return self._sections_of(Source(os.path.basename(file.path), file.text), file)
        if file.path not in self._sections:
            try:
                source = self._files.source(file.path, ".yaml", ".yml")
            except UnknownValue as error:
                message = f"the parameter file `{os.path.basename(file.path)}` is left out: {error}"
                self._findings.add("parameters", message, file.span)
                return None
            self._sections[file.path] = self._sections_of(source, file)
        return self._sections[file.path]

    def _sections_of(self, source: Source, file: ParameterFileName) -> list[SectionInFile] | None:
        reporter = Reporter()
        sections = read_sections(source, reporter)
        if not reporter.has_errors:
            return sections
        line = reporter.found[0].position[0]
        message = (
            f"`{os.path.basename(file.path)}` is left out: line {line} is not of a parameter file that can be read"
        )
        self._findings.add("parameters", message, file.span)
        return None
