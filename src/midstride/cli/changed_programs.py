"""The programs of the running system whose code has changed on disk, as the manager knows them."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator

from midstride.ament_index import executable
from midstride.cli.input_files import as_typed_here
from midstride.errors import StartFailed
from midstride.runtime.records.status_forms import InstanceStatus, ProgramStatus


def changed_code(programs: Iterable[ProgramStatus], roles: Collection[str]) -> dict[str, list[str]]:
    """The changed files of each of ``roles``; those of nodes that the manager cannot start are left out."""
    return {
        program.role: program.changed
        for program in programs
        if program.changed and program.startable and program.role in roles
    }


def code_words(paths: Iterable[str]) -> str:
    """The files of a program that have changed."""
    return f"code changed on disk: {', '.join(map(as_typed_here, paths))}"


def other_overlay(programs: Iterable[ProgramStatus | InstanceStatus]) -> Iterator[str]:
    """For each executable that this shell finds elsewhere than the manager does, a line.

    The manager keeps the AMENT_PREFIX_PATH with which it was started, whatever is sourced later.
    """
    nodes: dict[str, list[str]] = {}
    for program in programs:
        if program.executable:
            nodes.setdefault(program.executable, []).append(program.role)
    for path, roles in sorted(nodes.items()):
        package, name = os.path.basename(os.path.dirname(path)), os.path.basename(path)
        try:
            here = executable(package, name, os.environ)
        except StartFailed:
            continue
        if os.path.realpath(here) != os.path.realpath(path):
            yield (
                f"{', '.join(roles)}: `{name}` of package {package} is {here} in this shell, and {path} for the "
                "manager, which starts that one; `midstride down`, and `midstride up` in this shell, use the other"
            )
