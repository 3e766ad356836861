"""Names in generated code: the program file of a command, and unique attribute names."""

from __future__ import annotations

import keyword
import re
import shlex
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import Final, NamedTuple

_INTERPRETER: Final = re.compile(r"(/usr/bin/(env )?)?python3?(\.\d+)?")
_WORD: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class ProgramFile(NamedTuple):
    """The file that a command runs, relative to the system's folder; ``packaged``: it is a module of a package."""

    path: PurePosixPath
    packaged: bool


def program(run: str) -> ProgramFile | None:
    """The file that a command runs; None if it is not a Python program in the system's folder.

    ``python3 -m patrol.detector`` runs ``patrol/detector.py``, ``python3 talker.py`` runs ``talker.py``.
    """
    try:
        words = shlex.split(run)
    except ValueError:
        return None
    if words[:1] == ["/usr/bin/env"]:
        words = words[1:]
    if len(words) < 2 or not _INTERPRETER.fullmatch(words[0]):
        return None
    words = [word for word in words[1:] if word not in {"-u", "-O", "-B"}]
    if len(words) >= 2 and words[0] == "-m":
        parts = words[1].split(".")
        if not all(_WORD.fullmatch(part) and not keyword.iskeyword(part) for part in parts):
            return None
        return ProgramFile(PurePosixPath(*parts[:-1], f"{parts[-1]}.py"), len(parts) > 1)
    path = PurePosixPath(words[0]) if words else PurePosixPath()
    if path.suffix != ".py" or path.is_absolute() or ".." in path.parts:
        return None
    return ProgramFile(path, False)


def snake(name: str) -> str:
    """``ObstacleDetector`` as ``obstacle_detector``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


class AttributeNames:
    """Assigns unique attribute names: the preferred one, or one with a hint and underscores appended."""

    def __init__(self, used: Iterable[str]) -> None:
        self._used = set(used)

    def take(self, preferred: str, hint: str = "") -> str:
        name = re.sub(r"[^A-Za-z0-9_]", "_", preferred)
        if keyword.iskeyword(name) or keyword.issoftkeyword(name) or name.startswith("__"):
            name = f"{name.lstrip('_') or 'name'}_"
        if name in self._used and hint:
            name = f"{name.rstrip('_')}_{hint}"
        while name in self._used:
            name += "_"
        self._used.add(name)
        return name
