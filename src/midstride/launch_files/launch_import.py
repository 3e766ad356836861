"""From a launch file to a specification."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from midstride.errors import SpecificationError
from midstride.lang.source import Span
from midstride.lang.source_files import Bounds, include_folders
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.interpreter import Interpreter
from midstride.launch_files.launched_parameters import ParameterReader
from midstride.launch_files.packages import Packages
from midstride.launch_files.writer import specification, system_name


@dataclass(frozen=True, slots=True)
class Imported:
    """A specification, how many nodes it has, how many launch files were read, and what was left out or assumed."""

    text: str
    nodes: int
    files: int
    findings: ImportFindings


def import_launch_file(
    path: Path, arguments: Mapping[str, str], environment: Mapping[str, str], folder: Path, run_python: bool = False
) -> Imported:
    """The specification, which is to be in ``folder``. Raises SpecificationError if ``path`` is no launch file.

    With ``run_python``, launch files in Python are carried out: they are programs.
    """
    absolute = os.path.abspath(path)
    packages = Packages(environment, [os.path.abspath(each) for each in include_folders()])
    files, findings = ReadableFiles(Path(absolute), packages.roots()), ImportFindings()
    interpreter = Interpreter(files, findings, arguments, run_python)
    context = Context(packages, environment, absolute, variables=dict(arguments))
    try:
        interpreter.file(absolute, context)
    except UnknownValue as error:
        raise SpecificationError(f"cannot import {path}: {error}") from None
    start = Span(files.source(absolute), 0, 0)
    for name in interpreter.undeclared:
        findings.add("argument", f"no launch file that was read declares `{name}`", start)
    reader = ParameterReader(files, findings, Bounds.of(folder.absolute() / "system.stride").contain)
    heading = (
        f"Imported from {path.name}. A launch file does not state ports: while the nodes run,\n"
        "`midstride capture --into FILE` adds what they publish and subscribe to."
    )
    text = specification(system_name(absolute), interpreter.system, reader, findings, str(folder), heading)
    return Imported(text, len(interpreter.system.nodes), interpreter.system.files, findings)
