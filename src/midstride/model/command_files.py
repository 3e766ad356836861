"""The files that a command names, as far as they can be told from its words."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

_PYTHON: Final = re.compile(r"python[\d.]*\Z")
# Options of Python after which no file follows, and those that have a value.
_NO_FILE: Final = ("-c", "-m")
_WITH_VALUE: Final = ("-W", "-X")


def command_files(words: Sequence[str]) -> Iterator[str]:
    """The files among the words of a command: a program with a path, a script of Python's."""
    if words and "/" in words[0]:
        yield words[0]
    if words and _PYTHON.match(words[0].rpartition("/")[2]):
        options = iter(words[1:])
        for word in options:
            if word in _WITH_VALUE:
                next(options, None)
            elif not word.startswith("-"):
                yield word
                return
            elif word.startswith(_NO_FILE):
                return
