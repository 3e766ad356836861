"""A failed command's report: one clear line on standard error, and the exit status."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Final

import click

from midstride.cli.command_list import COMMANDS, WithoutCommand, cli
from midstride.cli.output import NO, USAGE, print_json
from midstride.errors import MidstrideError, SpecificationError

# Commands whose JSON document is a plan or an outcome: where they fail, it is `refused` beside `error`.
_CHANGES = ("plan", "replace", "restart", "add", "remove", "apply", "rollback", "demo")
# Click's messages name its own types, such as `integer range`.
_CLICK_TYPE: Final = re.compile(r"is not a valid (integer|float)( range)?$")
_NUMBERS: Final = {"integer": "whole number", "float": "number"}


def report(error: click.UsageError | MidstrideError | OSError, words: Sequence[str], program: str = "midstride") -> int:
    """Report why the command ``words`` of ``program`` failed. The exit status: NO or USAGE."""
    if isinstance(error, WithoutCommand):
        print(error.message, file=sys.stderr)
        return USAGE
    if isinstance(error, click.UsageError):
        path = error.ctx.command_path if error.ctx is not None else program
        message = error.format_message().rstrip(".")
        if isinstance(error, click.NoSuchOption) and error.option_name == "--include-path":
            message += f"; it comes before the command: `{program} --include-path DIR …`"
        parameters = error.ctx.command.params if error.ctx is not None else []
        if message.startswith("Got unexpected extra argument") and any(each.name == "system" for each in parameters):
            message += "; a system is named with --system NAME"
        message = _CLICK_TYPE.sub(lambda found: f"is not a {_NUMBERS[found[1]]}", message)
        _report(f"{path}: {_lower_first(message)}\ntry `{path} --help`", "UsageError", message, words)
        return USAGE
    if isinstance(error, OSError):  # refused for a file, which the error names, or else for our output
        subject = "cannot write the output" if error.filename is None else f"cannot use {error.filename}"
        error = MidstrideError(f"{subject}: {error.strerror or error}")
    if isinstance(error, SpecificationError):
        lines = [str(problem) for problem in error.problems]
    else:
        lines = [str(error.args[0]) if error.args else type(error).__name__]
    path = " ".join([program, *_command(words)])
    _report("\n".join(f"{path}: {line}" for line in lines), type(error).__name__, "\n".join(lines), words)
    return NO


def _command(words: Sequence[str]) -> list[str]:
    """The command that was typed, with its subcommand, as ``param set``; empty where there was none."""
    at = next((index for index, word in enumerate(words) if word in COMMANDS), None)
    if at is None:
        return []
    command = cli.get_command(click.Context(cli), words[at])
    subcommands = command.commands if isinstance(command, click.Group) else {}
    return [words[at], *[word for word in words[at + 1 :] if word in subcommands][:1]]


def _report(text: str, kind: str, message: str, words: Sequence[str]) -> None:
    print(text, file=sys.stderr)
    if "--json" in words:
        command = _command(words)
        document: dict[str, object] = {"error": {"kind": kind, "message": message}}
        if command and command[0] in _CHANGES and kind != "UsageError":
            outcome = "unknown" if kind == "OutcomeUnknown" else "refused"
            document = {"outcome": outcome, "because": message, **document}
        print_json(document)


def _lower_first(message: str) -> str:
    """Click capitalises its messages; ours follow a colon. What the user wrote, in backquotes, stays as it is."""
    head, _, rest = message.partition(" ")
    return f"{head.lower()} {rest}" if head.istitle() and not head.startswith("`") else message
