"""The words of a command, as launch makes them and as rcl reads them."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.substitutions import SubstitutionCall, Template, parse

_REMAP: Final = frozenset({"-r", "--remap"})
_PARAMETER: Final = frozenset({"-p", "--param"})
_ALONE: Final = frozenset(
    f"--{able}-{what}-logs" for able in ("enable", "disable") for what in ("rosout", "stdout", "external-lib")
)


def words_of(text: str, perform: Callable[[Template], str]) -> list[str]:
    """The words of a command in a launch file, as ``launch.actions.ExecuteProcess`` splits it.

    Only what is written out is split: the value of a substitution is a word, or part of one. Raises UnknownValue.
    """
    words: list[str] = []
    parts: list[str] = []
    open_word = False  # whether `parts` has something, be it empty

    def end() -> None:
        nonlocal open_word
        words.append("".join(parts))
        parts.clear()
        open_word = False

    for part in parse(text) or ("",):
        if isinstance(part, SubstitutionCall):
            parts.append(perform((part,)))
            open_word = True
            continue
        try:
            tokens = shlex.split(part)
        except ValueError as error:
            raise UnknownValue(f"a command cannot be split into words: {error}", "unsupported") from None
        if not tokens:
            end()
            continue
        if part[0].isspace() and open_word:
            end()
        parts.append(tokens[0])
        open_word = True
        if len(tokens) > 1:
            end()
            parts.append(tokens[-1])
            open_word = True
        words += tokens[1:-1]
        if part[-1].isspace():
            end()
    if open_word:
        end()
    return words


@dataclass(slots=True)
class RosArguments:
    """The arguments of a process for rcl. ``others``: options with their values, such as ``--log-level``.

    ``parameters``: each rule or file, in their order: ``("-p", RULE)`` or ``("--params-file", PATH)``.
    """

    name: str | None = None
    namespace: str | None = None
    remaps: list[tuple[str, str]] = field(default_factory=list)
    parameters: list[tuple[str, str]] = field(default_factory=list)
    others: list[str] = field(default_factory=list)


def split_ros_arguments(words: Sequence[str]) -> tuple[list[str], RosArguments]:
    """The arguments that the program itself gets, and those for rcl. The first of several rules for a name applies."""
    own: list[str] = []
    ros = RosArguments()
    for_ros = False
    position = 0
    while position < len(words):
        word = words[position]
        position += 1
        if word == "--ros-args":
            for_ros = True
        elif not for_ros:
            own.append(word)
        elif word == "--":
            for_ros = False
        elif word in _ALONE or position == len(words):
            ros.others.append(word)
        else:
            value = words[position]
            position += 1
            if word in _PARAMETER or word == "--params-file":
                ros.parameters.append(("--params-file" if word == "--params-file" else "-p", value))
            elif word not in _REMAP:
                ros.others += [word, value]
            else:
                old, _, new = value.partition(":=")
                if old == "__node":
                    ros.name = new if ros.name is None else ros.name
                elif old == "__ns":
                    ros.namespace = new if ros.namespace is None else ros.namespace
                else:
                    ros.remaps.append((old, new))
    return own, ros
