"""``ros2 midstride VERB``: the commands as extensions of ros2cli, which alone imports this module, by entry points.

ros2cli finds the command and its verbs, and lists them. What is written after a verb goes to Click as it is, to be
parsed or completed, so that there is one definition of the options, and one meaning of a line.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import click
from ros2cli.command import CommandExtension, add_subparsers_on_demand
from ros2cli.verb import VerbExtension

from midstride.cli.command_list import COMMANDS, cli

# The group of entry points with a verb each; other packages may add to it.
GROUP: Final = "midstride.verb"
PROGRAM: Final = "ros2 midstride"


class MidstrideCommand(CommandExtension):  # type: ignore[misc]  # ros2cli has no types
    """Replace the components of a running ROS system."""

    def add_arguments(
        self, parser: argparse.ArgumentParser, cli_name: str, *, argv: Sequence[str] | None = None
    ) -> None:
        self._parser = parser
        parser.set_defaults(midstride_options=())
        for option in cli.params:
            assert isinstance(option, click.Option)
            parser.add_argument(
                *option.opts,
                action=_KeepWords,
                dest="midstride_options",
                nargs=0 if option.is_flag else None,
                metavar=option.metavar,
                help=option.help,
            )
        add_subparsers_on_demand(parser, cli_name, "_verb", GROUP, required=False, argv=argv)

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
        verb = getattr(args, "_verb", None)
        if verb is not None:
            return int(verb.main(args=args) or 0)
        if args.midstride_options:
            return _run(args.midstride_options)
        self._parser.print_help()
        return 0


class Verb(VerbExtension):  # type: ignore[misc]
    """A command of Midstride."""

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str) -> None:
        # Without the first character of an option, every word is an argument, also one like `--yes`.
        parser.prefix_chars = ""
        words = parser.add_argument("midstride_words", nargs=argparse.REMAINDER)
        words.completer = _completed  # type: ignore[attr-defined]  # of argcomplete

    def main(self, *, args: argparse.Namespace) -> int:
        return _run([*args.midstride_options, self.NAME, *args.midstride_words])


class _KeepWords(argparse.Action):
    """Keeps an option as it is written, with its value."""

    def __call__(self, _: Any, namespace: argparse.Namespace, value: Any, name: str | None = None) -> None:
        words = [name, value] if isinstance(value, str) else [name]
        # ros2cli parses the line twice, and the default is the parser's.
        setattr(namespace, self.dest, (*getattr(namespace, self.dest), *words))


def _run(words: Sequence[str]) -> int:
    from midstride.cli import main

    return main(words, PROGRAM)


def _completed(prefix: str, **_: Any) -> dict[str, str]:
    """For argcomplete: what Click completes the word with, and its help."""
    from argcomplete import split_line  # type: ignore[attr-defined]  # of all its versions
    from argcomplete.completers import DirectoriesCompleter, FilesCompleter

    from midstride.cli.shell_completion import candidates

    point = len(os.environ["COMP_LINE"].encode()[: int(os.environ["COMP_POINT"])].decode(errors="ignore"))
    words = split_line(os.environ["COMP_LINE"], point)[3]
    found: dict[str, str] = {}
    for item in candidates(cli, words[words.index("midstride", 1) + 1 :], prefix):
        if item.type == "plain":
            found[item.value] = item.help or ""
        else:
            files = FilesCompleter() if item.type == "file" else DirectoriesCompleter()
            found.update(dict.fromkeys(files(prefix), ""))
    return found


@cache
def __getattr__(name: str) -> type[Verb]:
    """The verb of a command, for its entry point."""
    if name not in COMMANDS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    summary = COMMANDS[name][1]
    return type(f"{name.capitalize()}Verb", (Verb,), {"NAME": name, "__doc__": f"{summary[0].upper()}{summary[1:]}."})
