"""Shell completion: Click's machinery, and the names of the running system and of the file on the command line.

The shell waits while this runs and shows whatever it prints, so it gives up early and prints nothing on an error.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    FishComplete,
    ShellComplete,
    ZshComplete,
    add_completion_class,
    get_completion_class,
    split_arg_string,
)

from midstride.cli.specification_argument import path_of_words
from midstride.codec.form import Document
from midstride.errors import MidstrideError

VARIABLE: Final = "_MIDSTRIDE_COMPLETE"
# How long a manager may take to answer (s); a person is waiting in the middle of a line.
TIMEOUT: Final = 0.3
# Where Bash splits words, by default, that are one word to every program.
_SPLIT: Final = ("=", ":", ":=")

Complete = Callable[[click.Context, click.Parameter, str], list[str]]


def complete(cli: click.Command, instruction: str) -> int:
    """Print the shell's script (``bash_source``) or candidates (``bash_complete``). The exit status."""
    shell, _, action = instruction.partition("_")
    try:
        if (shell_class := get_completion_class(shell)) is None:
            return 1
        completion = shell_class(cli, {}, "midstride", VARIABLE)
        if text := completion.source() if action == "source" else completion.complete():
            click.echo(text)
        return 0
    except Exception:
        return 1


@add_completion_class
class _Bash(BashComplete):
    """Bash splits a word at ``=`` and ``:`` and completes the last piece alone; Click expects whole words."""

    _prefix = ""

    def get_completion_args(self) -> tuple[list[str], str]:
        current = int(os.environ["COMP_CWORD"])
        pieces = split_arg_string(os.environ["COMP_WORDS"])[1 : current + 1]
        words: list[str] = []
        for piece in [*pieces, *[""] * (current - len(pieces))]:
            if words and (piece in _SPLIT or words[-1].endswith(_SPLIT)):
                words[-1] += piece
            else:
                words.append(piece)
        *before, incomplete = words
        self._prefix = incomplete[: max(map(incomplete.rfind, _SPLIT)) + 1]
        return before, incomplete

    def format_completion(self, item: CompletionItem[str]) -> str:
        return f"{item.type},{item.value.removeprefix(self._prefix)}"


class _WholeWord(ShellComplete):
    """For ``--option=value``, Click offers the value alone; Zsh and Fish replace the whole word."""

    def get_completions(self, args: list[str], incomplete: str) -> list[CompletionItem[str]]:
        items = super().get_completions(args, incomplete)
        option, equals, _ = incomplete.partition("=")
        if equals and option.startswith("-"):
            for item in items:
                item.value = f"{option}={item.value}"
        return items


@add_completion_class
class _Zsh(_WholeWord, ZshComplete):
    pass


@add_completion_class
class _Fish(_WholeWord, FishComplete):
    pass


def candidates(cli: click.Command, words: list[str], incomplete: str) -> list[CompletionItem[str]]:
    """Words that may follow the ``words`` of a line, for one that is typed so far. An error means no candidates."""
    try:
        return _WholeWord(cli, {}, "midstride", VARIABLE).get_completions(words, incomplete)
    except Exception:
        return []


# -- candidates -------------------------------------------------------------------------------------------


def _completer(candidates: Callable[[click.Context, str], Iterable[str]]) -> Complete:
    """The callback for Click, from a function of the context and the word so far. An error means no candidates."""

    def completed(context: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
        try:
            return sorted({name for name in candidates(context, incomplete) if name.startswith(incomplete)})
        except (MidstrideError, OSError, LookupError, TypeError, ValueError):
            return []

    return completed


@_completer
def systems(_: click.Context, __: str) -> Iterable[str]:
    """Names of running systems."""
    from midstride.runtime.workspace import Workspace

    return [workspace.name for workspace in Workspace.all()]


@_completer
def nodes(context: click.Context, _: str) -> Iterable[str]:
    """Nodes of the system, without those that the line names already."""
    named = context.params.get("nodes") or ()
    return (name for name in _system(context)["nodes"] if name not in named)


@_completer
def nodes_and_containers(context: click.Context, _: str) -> Iterable[str]:
    """Nodes and containers of the system, without those that the line names already."""
    named, system = context.params.get("nodes") or (), _system(context)
    return (name for name in [*system["nodes"], *system.get("containers", {})] if name not in named)


@_completer
def components(context: click.Context, _: str) -> Iterable[str]:
    """Components of the running system and of the file given with ``--from``."""
    return _components(context)


@_completer
def hosts(context: click.Context, _: str) -> Iterable[str]:
    """The hosts of the system, and the word for that of the manager."""
    return [*_system(context).get("hosts", {}), "manager"]


@_completer
def functionalities(context: click.Context, _: str) -> Iterable[str]:
    """``NODE.FUNCTIONALITY``."""
    system = _system(context)
    return [
        f"{role}.{functionality}"
        for role, node in system["nodes"].items()
        for functionality in system["components"][node["component"]].get("functionalities", {})
    ]


@_completer
def parameters(context: click.Context, _: str) -> Iterable[str]:
    """Parameters of the running node that the line names."""
    node, status = context.params["node"], _ask(context, "/view")
    components = [each for each in status["instances"] if node in (each["name"], each["role"])]
    return [parameter["name"] for component in components for parameter in component["parameters"]]


@_completer
def settings(context: click.Context, _: str) -> Iterable[str]:
    """``NODE NAME``, or ``NODE.NAME=`` for several: of the running nodes and their parameters."""
    words, instances = context.params.get("words") or (), _ask(context, "/view")["instances"]
    if words and "=" not in words[0]:
        named = [each for each in instances if words[0] in (each["name"], each["role"])] if len(words) == 1 else []
        return [parameter["name"] for each in named for parameter in each["parameters"]]
    several = [f"{each['role']}.{parameter['name']}=" for each in instances for parameter in each["parameters"]]
    return several if words else [*_system(context)["nodes"], *several]


@_completer
def attachments(context: click.Context, _: str) -> Iterable[str]:
    """``PORT=TOPIC`` for the component that the line names."""
    component = _components(context)[context.params["component"]]
    ports = [*component.get("inputs", {}), *component.get("outputs", {})]
    return [f"{port}={topic}" for port in ports for topic in _running(context)["topics"]]


@_completer
def replacements(context: click.Context, incomplete: str) -> Iterable[str]:
    """``NODE=COMPONENT``: first the node, then its component."""
    system = _system(context)
    role, equals, _ = incomplete.partition("=")
    return [f"{role}={name}" for name in system["components"]] if equals else [f"{name}=" for name in system["nodes"]]


@_completer
def codes(_: click.Context, incomplete: str) -> Iterable[str]:
    """Codes of diagnostics."""
    from midstride.lang.catalogue import CATALOGUE

    return [code.lower() if incomplete[:1].islower() else code for code in CATALOGUE]


@_completer
def examples(_: click.Context, __: str) -> Iterable[str]:
    """Names of the examples that ``demo`` runs."""
    from midstride.cli.example import known_examples

    return known_examples()


# -- where names come from ----------------------------------------------------------------------------------


def _system(context: click.Context) -> Document:
    """The system that the command is about: that of its file, where it names one, else the running one."""
    parameters = {parameter.name: parameter for parameter in context.command.params}
    if isinstance(parameters.get("file"), click.Argument):
        named = context.params.get("file")
        if named is None and context.args:  # while the value of an option is missing, Click leaves them unparsed
            words = context.args if parameters["file"].nargs == -1 else context.args[:1]
            named = path_of_words(tuple(words))
        if named is not None:
            return _file(Path(named))
    return _running(context)


def _components(context: click.Context) -> dict[str, Document]:
    found = dict(_running(context)["components"])
    if (file := context.params.get("file")) is not None:
        found |= _file(file)["components"]
    return found


def _file(path: Path) -> Document:
    from midstride.cli.input_files import read
    from midstride.codec.specification_form import encode_specification

    return encode_specification(read(path))


def _running(context: click.Context) -> Document:
    """The specification of the running system that ``--system`` names, else of the only one."""
    return _ask(context, "/specification")


def _ask(context: click.Context, path: str) -> Document:
    """Ask the manager of that system."""
    import json

    from midstride.cli.client import Client
    from midstride.runtime.workspace import Workspace

    system = context.params.get("system")
    found: list[Document] = []
    for workspace in Workspace.all():
        if system in (None, workspace.name):
            with suppress(MidstrideError):
                found.append(json.loads(Client(workspace.socket).text(path, timeout=TIMEOUT)))
    (only,) = found
    return only
