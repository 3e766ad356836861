"""The parts of the reference of the commands that follow from the commands: each `--help`, as Markdown.

A part is between `<!-- midstride NAME -->` and `<!-- end -->`. What the help does not say is around it, by hand.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Final

import click

from midstride.cli.command_list import COMMANDS, GROUPS, cli

BLOCK: Final = re.compile(r"<!-- midstride (?P<name>[^>]*) -->\n(?P<text>.*?)<!-- end -->", re.DOTALL)
CHANGES: Final = "Changes to the running system"
# The options of (nearly) every command; the page has them once.
# The default and the range, behind the words.
_EXTRA: Final = re.compile(r"  \[(.*)\]$")
_EVERYWHERE: Final = {"json", "help", "system"}


def blocks() -> Mapping[str, str]:
    """Each part by its name."""
    found = {heading: _index(heading) for heading in GROUPS}
    changes = [_command(name) for name in GROUPS[CHANGES] if name != "param"]
    common = set.intersection(*({each.name or "" for each in command.params} for command in changes)) - _EVERYWHERE
    found["CHANGE"] = "\n".join(_options(changes[0], common))
    for name in COMMANDS:
        command = _command(name)
        if isinstance(command, click.Group):
            found[name] = "\n\n".join(_paragraphs(command))
            for part, subcommand in command.commands.items():
                found[f"{name} {part}"] = _block(f"{name} {part}", subcommand, set())
        else:
            found[name] = _block(name, command, common if name in GROUPS[CHANGES] else set())
    return found


def block(name: str, text: str) -> str:
    """The part as it is in the page."""
    return f"<!-- midstride {name} -->\n\n{text}\n\n<!-- end -->"


def _command(name: str) -> click.Command:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    return command


def _index(heading: str) -> str:
    rows = [f"| [`{name}`](#{name}) | {summary} |" for name, (_, summary) in GROUPS[heading].items()]
    return "\n".join(["| command | purpose |", "|---|---|", *rows])


def _block(name: str, command: click.Command, elsewhere: set[str]) -> str:
    shown = {option.name or "" for option in command.params} - elsewhere - _EVERYWHERE
    usage = " ".join(["midstride", name, *command.collect_usage_pieces(_context(command))])
    options = list(_options(command, shown))
    options += ["- the [options of every change](#options-of-every-change)"] if elsewhere else []
    return "\n\n".join([f"**`{usage}`**", *_paragraphs(command), *(["\n".join(options)] if options else [])])


def _paragraphs(command: click.Command) -> Iterator[str]:
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith("\b\n"):  # click keeps the lines of these
            yield f"```shell\n{paragraph.removeprefix(chr(8)).strip()}\n```"
        else:
            yield _marked(" ".join(paragraph.split()))


def _options(command: click.Command, shown: set[str]) -> Iterator[str]:
    for option in command.params:
        if isinstance(option, click.Option) and option.name in shown and not option.hidden:
            record = option.get_help_record(_context(command))
            assert record is not None
            names, words = record
            yield f"- `{names}`: {_marked(_EXTRA.sub(_in_parentheses, words))}"


def _in_parentheses(found: re.Match[str]) -> str:
    return f" ({found[1].replace('][', '; ').replace(']  [', '; ')})"


def _marked(text: str) -> str:
    """Options are code here, and pages of the documentation are links."""
    text = re.sub(r"docs/((?:how-to/)?([\w-]+)\.md)", r"[\2](../\1)", text)
    outside = re.compile(r"(?<![\w-])--[a-z][\w-]*")
    parts = text.split("`")  # every other one is code already
    return "`".join(part if index % 2 else outside.sub(r"`\g<0>`", part) for index, part in enumerate(parts))


def _context(command: click.Command) -> click.Context:
    return click.Context(command, show_default=None)
