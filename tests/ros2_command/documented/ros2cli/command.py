"""The extension point `ros2cli.command`, and the verbs of a command by the entry points of a group."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any


class CommandExtension:
    """A command of `ros2`: NAME is that of its entry point; the first line of its docstring is shown."""

    NAME: str | None = None

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str, *, argv: Any = None) -> None: ...

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> object:
        raise NotImplementedError


def summary(extension: object) -> str:
    lines = (extension.__doc__ or "").strip().splitlines()
    return lines[0].rstrip(".") if lines else ""


def add_subparsers_on_demand(
    parser: argparse.ArgumentParser,
    cli_name: str,
    dest: str,
    group_name: str,
    hide_extensions: Sequence[str] | None = None,
    required: bool = True,
    argv: Sequence[str] | None = None,
) -> object:
    """A subparser for each entry point of the group, with the extension that it leads to as ``dest``."""
    extensions = {}
    for entry in sorted(entry_points(group=group_name), key=lambda entry: entry.name):
        extensions[entry.name] = entry.load()()
        extensions[entry.name].NAME = entry.name
    shown = {name: each for name, each in extensions.items() if name not in (hide_extensions or ())}
    subparsers = parser.add_subparsers(
        title="Commands",
        description="\n".join(f"{name}  {summary(each)}" for name, each in shown.items()),
        metavar=f"Call `{cli_name} <command> -h` for more detailed usage.",
        required=required,
    )
    for name, extension in extensions.items():
        each = subparsers.add_parser(name, formatter_class=argparse.RawDescriptionHelpFormatter)
        each.description = summary(extension)
        each.set_defaults(**{dest: extension})
        if hasattr(extension, "add_arguments"):
            given = {"argv": argv} if "argv" in inspect.signature(extension.add_arguments).parameters else {}
            extension.add_arguments(each, f"{cli_name} {name}", **given)
    return subparsers
