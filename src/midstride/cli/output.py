"""Where output goes: a console for people, one JSON document for programs."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click

from midstride.cli.app import Settings

if TYPE_CHECKING:
    from rich.console import Console


UNFOLDED = 1000


def wants_json() -> bool:
    """Whether ``--json`` stands on the command line."""
    settings = click.get_current_context().find_object(Settings)
    return settings is not None and settings.json


def print_json(document: Any) -> None:
    print(json.dumps(document, indent=2, ensure_ascii=False, default=_plain))


def _plain(form: Any) -> Any:
    """A form (midstride.codec) as plain dicts and lists."""
    import msgspec

    return msgspec.to_builtins(form)


def console(stderr: bool = False) -> Console:
    """A console on standard output or standard error. What its encoding cannot show becomes a question mark."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    reconfigure = getattr(stream, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="replace")
    # Piped output is not folded at 80 columns: programs and `grep` read it.
    width = None if stream.isatty() else UNFOLDED
    return Console(file=stream, highlight=False, emoji=False, width=width)


def is_interactive() -> bool:
    """Whether a person can be asked."""
    return sys.stdin.isatty() and sys.stderr.isatty()
