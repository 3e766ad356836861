"""The results of a command: a console for people, one JSON document for programs, the exit status."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO, cast

import click

if TYPE_CHECKING:
    from rich.console import Console


NO: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130
# The width of output that is not a terminal: wide enough that nothing is folded, for programs and `grep`.
PIPE_WIDTH: Final = 1000
# That of a table with long texts in the middle of its rows, where output is not a terminal: what a page shows.
PAGE_WIDTH: Final = 120


def json_option(function: Any) -> Any:
    """``--json``, accepted before and after the command's name."""
    summary = "Print one JSON document, and nothing else."
    return click.option("--json", is_flag=True, expose_value=False, callback=_set_json, help=summary)(function)


def stride_output(summary: str) -> Callable[[Any], Any]:
    """``--output FILE.stride``, as ``output``: where a specification is written to."""
    file = click.Path(path_type=Path, dir_okay=False)
    return click.option("-o", "--output", type=file, metavar="FILE.stride", help=summary)


def _set_json(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    ctx.meta[__name__] = value or ctx.meta.get(__name__, False)  # shared by the contexts of all commands


def wants_json() -> bool:
    """Return whether the command line has ``--json``."""
    return bool(click.get_current_context().meta.get(__name__))


def print_json(document: Any, *, lines: bool = False) -> None:
    """Print a document, in which there may be forms (midstride.codec); with ``lines``, on one line, at once."""
    import msgspec

    from midstride.model.printable import printable

    indent = None if lines else 2
    text = json.dumps(document, indent=indent, ensure_ascii=False, default=msgspec.to_builtins)
    if printable(text) != text:
        text = "".join(c if printable(c) == c else json.dumps(c)[1:-1] for c in text)
    print(text, flush=lines)


def show(document: Any, lines: Iterable[object]) -> None:
    """Print the result of a command: with ``--json`` the document, else the lines."""
    if wants_json():
        print_json(document)
        return
    for line in lines:
        click.echo(str(line))


class PrintableStream:
    """A text stream that escapes control characters: they may come from anybody's file or component.

    ``raw`` is the stream below, for what writes control characters itself.
    """

    buffer: Final = None  # click would write to it

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

    def write(self, text: str) -> int:
        if not (text.isascii() and text.replace("\n", "").isprintable()):  # else the import would slow `--help` down
            from midstride.model.printable import printable

            text = printable(text)
        return self.raw.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.raw, name)


class UnpaddedStream:
    """A text stream without the blanks at the ends of lines with which tables are as wide as their longest row.

    Lines have to be written whole.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        self._stream.write(re.sub(r"[ ]+$", "", text, flags=re.MULTILINE))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def printable_output() -> Iterator[None]:
    """Within it, standard output and standard error are :class:`PrintableStream`."""
    out, err = (cast("TextIO", PrintableStream(stream)) for stream in (sys.stdout, sys.stderr))
    with redirect_stdout(out), redirect_stderr(err):
        yield


def console(stderr: bool = False) -> Console:
    """A console on standard output or standard error. Characters that its encoding lacks become question marks."""
    from midstride.cli.console import PrintableConsole

    stream = sys.stderr if stderr else sys.stdout
    stream = getattr(stream, "raw", stream)
    reconfigure = getattr(stream, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="replace")
    if stream.isatty():
        return PrintableConsole(file=stream, highlight=False, emoji=False)
    unpadded = cast("TextIO", UnpaddedStream(stream))
    return PrintableConsole(file=unpadded, highlight=False, emoji=False, width=PIPE_WIDTH)


def is_interactive() -> bool:
    """Return whether the command can ask the user."""
    return sys.stdin.isatty() and sys.stderr.isatty()
