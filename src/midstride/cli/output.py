"""Where output goes: a console for people, one JSON document for programs."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click

from midstride.cli.app import Settings

if TYPE_CHECKING:
    from rich.console import Console


# The width of output that is not a terminal: wide enough that nothing is folded, for programs and `grep`.
PIPE_WIDTH = 1000


def wants_json() -> bool:
    """Whether the command line has ``--json``."""
    settings = click.get_current_context().find_object(Settings)
    return settings is not None and settings.json


def print_json(document: Any) -> None:
    print(json.dumps(document, indent=2, ensure_ascii=False))


def console(stderr: bool = False) -> Console:
    """A console on standard output or standard error. Characters that its encoding lacks become question marks."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    reconfigure = getattr(stream, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="replace")
    width = None if stream.isatty() else PIPE_WIDTH
    return Console(file=stream, highlight=False, emoji=False, width=width)


def is_interactive() -> bool:
    """Whether the command can ask the user."""
    return sys.stdin.isatty() and sys.stderr.isatty()
