"""The programs of the running system whose code has changed on disk, as the manager knows them."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from midstride.cli.client import Client
from midstride.cli.input_files import as_typed_here


def changed_code(client: Client, roles: Collection[str]) -> dict[str, list[str]]:
    """The changed files of each of ``roles``; those of nodes that the manager cannot start are left out."""
    return {
        program.role: program.changed
        for program in client.programs()
        if program.changed and program.startable and program.role in roles
    }


def code_words(paths: Iterable[str]) -> str:
    """The files of a program that have changed."""
    return f"code changed on disk: {', '.join(map(as_typed_here, paths))}"
