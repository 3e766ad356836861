"""Text as it is shown: what is quoted may come from anybody's file, and a terminal carries out control characters."""

from __future__ import annotations

import unicodedata
from typing import Final

_HIDDEN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
# The joiners of scripts and emoji are format characters, too, and change nothing beyond their neighbours.
_KEPT: Final = frozenset("\n\t\u200c\u200d")


class _Escapes(dict[int, str]):
    """The text for each code point, computed when it is first needed."""

    def __missing__(self, code: int) -> str:
        character = chr(code)
        hidden = unicodedata.category(character) in _HIDDEN and character not in _KEPT
        self[code] = ascii(character)[1:-1] if hidden else character
        return self[code]


_ESCAPES: Final = _Escapes()


def printable(text: str) -> str:
    """``text`` with every control character escaped, as in ``\\x1b[2J`` or ``\\u202e``, except line breaks and tabs."""
    return text if text.isascii() and text.isprintable() else text.translate(_ESCAPES)


def on_one_line(text: str) -> str:
    """``text`` with line breaks and tabs escaped as well."""
    return printable(text).replace("\n", "\\n").replace("\t", "\\t")
