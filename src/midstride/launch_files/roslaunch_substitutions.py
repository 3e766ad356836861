"""Substitutions such as ``$(arg name)`` in the launch files of ROS 1: their grammar, and their values.

They are not nested, and have no quotes. ``$(find PACKAGE)`` comes last, since a path that follows it may name an
executable, which catkin installs in another folder than the package's other files.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

from midstride.launch_files.context import Context
from midstride.launch_files.expression import evaluate, shortened
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.packages import RosPackagePath
from midstride.launch_files.roslaunch_values import guessed

_EVAL: Final = "$(eval "
_CALL: Final = re.compile(r"\$\(([^)]*)(\)?)")


def resolved(text: str, context: Context) -> str:
    """``text`` with the values of its substitutions. Raises UnknownValue."""
    if text.startswith(_EVAL) and text.endswith(")"):
        return _evaluated(text.removeprefix(_EVAL)[:-1], context)
    return _with_packages(_CALL.sub(lambda match: _value(match, text, context), text), context)


def _words(match: re.Match[str], text: str) -> list[str]:
    """The words of a substitution; none where the text is not one. Raises UnknownValue."""
    if "$" in match[1] or "(" in match[1]:
        raise UnknownValue(f"`{shortened(text)}`: substitutions of roslaunch have no `$` and no `(` in them")
    return match[1].split() if match[2] else []


def _value(match: re.Match[str], text: str, context: Context) -> str:
    words = _words(match, text)
    if not words:
        return match[0]
    name, *arguments = words
    if name == "eval":
        raise UnknownValue(f"`{shortened(text)}`: `$(eval …)` has to be all of a value")
    if name not in _FUNCTIONS:
        raise UnknownValue(f"`{shortened(match[0])}`: there is no substitution `{name}`")
    low, high, function = _FUNCTIONS[name]
    if not low <= len(arguments) <= high:
        raise UnknownValue(f"`{shortened(match[0])}`: wrong number of arguments")
    return match[0] if function is None else function(context, arguments)


def _with_packages(text: str, context: Context) -> str:
    """``text`` with the folders of packages, or with the executables that are meant by the paths that follow."""
    done = ""
    while match := _CALL.search(text):
        words = _words(match, text)
        done, text = f"{done}{text[: match.start()]}", text[match.end() :]
        if len(words) != 2 or words[0] != "find":
            done += match[0]
            continue
        path = text.partition(" ")[0]
        if program := _executable(context, words[1], path):
            done, text = f"{done}{program}", text[len(path) :]
        else:
            done += context.packages.share(words[1])
    return done + text


def _executable(context: Context, package: str, path: str) -> str | None:
    assert isinstance(context.packages, RosPackagePath)
    name = os.path.basename(path)
    return context.packages.installed_executable(package, name) if name and path.startswith("/") else None


def _environment(context: Context, words: Sequence[str]) -> str:
    if words[0] not in context.environment:
        raise UnknownValue(f"the environment variable `{words[0]}` is not set")
    return context.environment[words[0]]


def _optional(context: Context, words: Sequence[str]) -> str:
    return context.environment.get(words[0], " ".join(words[1:]))


_Function: TypeAlias = Callable[[Context, Sequence[str]], str]
_MANY: Final = 1000
# The least and the largest number of arguments, and the value; None for what comes last.
_FUNCTIONS: Final[dict[str, tuple[int, int, _Function | None]]] = {
    "arg": (1, 1, lambda context, words: context.variable(words[0])),
    "env": (1, 1, _environment),
    "optenv": (1, _MANY, _optional),
    "anon": (1, 1, lambda _, words: words[0]),  # an import has to choose the same name each time
    "dirname": (0, 0, lambda context, _: os.path.dirname(context.file)),
    "find": (1, 1, None),
}


def _evaluated(expression: str, context: Context) -> str:
    """The value of an expression. Arguments are named in it, unless a function of `math` has their name."""
    if "__" in expression:
        raise UnknownValue("`$(eval …)` must not have `__` in it")
    names: dict[str, Any] = {
        name: guessed(value) if isinstance(value, str) else value
        for name, value in context.variables.items()
        if not hasattr(math, name)
    }
    functions = {
        "true": True,
        "false": False,
        "arg": lambda name: guessed(context.variable(name)),
        "env": lambda name: _environment(context, [name]),
        "optenv": lambda name, default="": _optional(context, [name, default]),
        "find": context.packages.share,
        "anon": str,
        "dirname": lambda: os.path.dirname(context.file),
    }
    return evaluate(expression, {**names, **functions})
