"""The programs of the running system whose code has changed on disk, as the manager knows them."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable

from midstride.cli.client import Client


def changed_code(client: Client, roles: Collection[str]) -> dict[str, list[str]]:
    """The changed files of each of ``roles``; those of nodes that the manager cannot start are left out."""
    return {
        program["role"]: program["changed"]
        for program in client.get("/programs")
        if program["changed"] and program["startable"] and program["role"] in roles
    }


def shown(paths: Iterable[str]) -> str:
    """The paths, those below the current folder relative to it."""
    below = f"{os.getcwd()}/"
    return ", ".join(path.removeprefix(below) for path in paths)


def code_words(paths: Iterable[str]) -> str:
    return f"code changed on disk: {shown(paths)}"
