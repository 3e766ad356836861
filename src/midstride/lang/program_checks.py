"""The files that components run: a warning for each that is not there.

A program is started in the folder of the system's file, without a shell. Only a file that `run` names is looked up, or
the executable of a package: what is on the search path is known on the robot alone.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

from midstride.ament_index import component_library, executable
from midstride.errors import StartFailed
from midstride.model.command_files import command_files
from midstride.model.component import ContainerProgram
from midstride.model.diagnostics import Problem, SubjectPath
from midstride.model.near_miss import did_you_mean
from midstride.model.specification import Specification


def missing_programs(specification: Specification, folder: Path) -> Iterator[Problem]:
    """W161 for each `run` that names what is not there; ``folder`` is that of the system's file.

    What runs on other hosts alone is not looked up: their files are not seen from here.
    """
    seen = set()
    here = {node.component for node in specification.nodes.values() if not node.host}
    elsewhere = {node.component for node in specification.nodes.values()} - here
    for name, shared in sorted(specification.containers.items()):
        if shared.host:
            continue
        yield from _container(shared, ("containers", name), f"container {name}")
    alone = {node.component for node in specification.nodes.values() if node.container is None and not node.host}
    for name, component in sorted(specification.components.items()):
        key = component.run, component.package, component.container
        if component.run is None or key in seen or name in elsewhere:
            continue
        seen.add(key)
        if component.package is not None:
            try:
                program = shlex.split(component.run)[0]
                if component.container is None:
                    executable(component.package, program, os.environ)
                else:
                    component_library(component.package, program, os.environ)
            except StartFailed as error:
                message = f"component {name} runs `{component.run}`, but {error}"
                yield Problem("W161", ("components", name, "package"), message)
            if component.container is not None and name in alone:
                yield from _container(component.container, ("components", name, "container"), f"component {name}")
            continue
        for file in command_files(shlex.split(component.run)):
            if not (folder / file).exists():
                message = f"component {name} runs `{component.run}`, but there is no file {folder / file}"
                yield Problem("W161", ("components", name, "run"), message, _help(folder / file))


def _container(program: ContainerProgram, path: SubjectPath, what: str) -> Iterator[Problem]:
    try:
        executable(program.package, shlex.split(program.run)[0], os.environ)
    except StartFailed as error:
        verb = "is loaded by" if path[0] == "components" else "runs"
        yield Problem("W161", (*path, "run"), f"{what} {verb} `{program.run}`, but {error}")


def _help(missing: Path) -> str:
    try:
        names = [entry.name for entry in missing.parent.iterdir()]
    except OSError:
        names = []
    generated = "`midstride generate` writes a skeleton; or " if missing.suffix == ".py" else ""
    return did_you_mean(missing.name, names) or f"{generated}correct the path, which is relative to this file's folder"
