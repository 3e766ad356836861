"""The results of a command: a console for people, one JSON document for programs, the exit status."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any, Final

import click

if TYPE_CHECKING:
    from rich.console import Console


NO: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130
# The width of output that is not a terminal: wide enough that nothing is folded, for programs and `grep`.
PIPE_WIDTH: Final = 1000


def json_option(function: Any) -> Any:
    """``--json``, accepted before and after the command's name."""
    summary = "Print one JSON document, and nothing else."
    return click.option("--json", is_flag=True, expose_value=False, callback=_set_json, help=summary)(function)


def _set_json(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    ctx.meta[__name__] = value or ctx.meta.get(__name__, False)  # shared by the contexts of all commands


def wants_json() -> bool:
    """Whether the command line has ``--json``."""
    return bool(click.get_current_context().meta.get(__name__))


def print_json(document: Any) -> None:
    """Print a document, in which there may be forms (midstride.codec)."""
    import msgspec

    print(json.dumps(document, indent=2, ensure_ascii=False, default=msgspec.to_builtins))


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
