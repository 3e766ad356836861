"""From a launch file to a specification."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from midstride.errors import SpecificationError
from midstride.lang.source import Span
from midstride.lang.source_files import Bounds, include_folders
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, IncludeTrace, RoslaunchContext
from midstride.launch_files.dialects import Ros, dialect_of
from midstride.launch_files.entity import ENDINGS, NotALaunchFile, read_entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launch_interpreter import LaunchInterpreter
from midstride.launch_files.launched_containers import Containers, keep_containers, split_containers
from midstride.launch_files.launched_parameters import ParameterReader
from midstride.launch_files.packages import Packages, RosPackagePath
from midstride.launch_files.roslaunch_interpreter import RoslaunchInterpreter
from midstride.launch_files.writer import SpecificationDraft, system_name
from midstride.model.lifecycle_management import Management


@dataclass(frozen=True, slots=True)
class Imported:
    """A specification, how many nodes it has, how many launch files were read, what was left out or assumed, and for
    which ROS the launch file is.

    ``parameter_files``: the texts of parameter files beside the specification, which names them, for what the language
    cannot state, by their names.
    """

    text: str
    nodes: int
    files: int
    findings: ImportFindings
    ros: Ros
    parameter_files: Mapping[str, str] = field(default_factory=dict)


def import_launch_file(
    path: Path,
    arguments: Mapping[str, str],
    environment: Mapping[str, str],
    target: Path | None,
    run_python: bool = False,
    run_commands: bool = False,
    management: Management = "manager",
    containers: Containers = "keep",
    ros: Ros | None = None,
) -> Imported:
    """The specification, which is to be written to ``target``. Raises SpecificationError if ``path`` is no launch file.

    ``target``: None if it is not written to a file; then nothing is written beside it either. With ``run_python``,
    launch files in Python are carried out, which are programs; with ``run_commands``, substitutions that run programs.
    ``management``: what manages the nodes of a lifecycle manager; ``containers``: what becomes of composable nodes.
    ``ros``: for which ROS the launch file is to be read; unless stated, its elements decide.
    """
    absolute = os.path.abspath(path)
    try:
        ros = ros or _dialect(absolute)
        folders = [os.path.abspath(each) for each in include_folders()]
        packages = RosPackagePath(environment, folders) if ros == 1 else Packages(environment, folders)
        files = ReadableFiles(Path(absolute), packages.roots(), packages.installed_folders())
        variables: dict[str, str | UnknownValue] = dict(arguments)
        scope = packages, files, environment, absolute, IncludeTrace(absolute), run_commands, variables
        interpreter: LaunchInterpreter | RoslaunchInterpreter
        if ros == 1:
            findings = ImportFindings("roslaunch")
            interpreter = RoslaunchInterpreter(files, findings, arguments)
            interpreter.main(absolute, RoslaunchContext(*scope))
        else:
            findings = ImportFindings("launch")
            interpreter = LaunchInterpreter(files, findings, arguments, run_python, containers)
            interpreter.main(absolute, Context(*scope))
    except UnknownValue as error:
        raise SpecificationError(f"cannot import {path}: {error}") from None
    (keep_containers if containers == "keep" else split_containers)(interpreter.system, findings)
    start = Span(files.source(absolute), 0, 0)
    for name in interpreter.undeclared:
        findings.add("argument", f"no launch file that was read declares `{name}`", start)
    folder = Path() if target is None else target.parent
    bounds = Bounds.of(folder.absolute() / "system.stride")
    reader = ParameterReader(files, findings, bounds.contain)
    draft = SpecificationDraft(system_name(absolute), interpreter.system, reader, findings, target, management, ros)
    text = draft.text(path.name)
    return Imported(text, draft.nodes, interpreter.system.files, findings, ros, draft.parameter_files)


def _dialect(path: str) -> Ros:
    """The ROS that a launch file is for. Raises UnknownValue where it mixes both, or cannot be read."""
    if path.endswith(".py"):
        return 2
    try:
        return dialect_of(read_entity(ReadableFiles(Path(path), ()).source(path, *ENDINGS)))
    except NotALaunchFile:
        return 2  # which is reported as it is carried out
