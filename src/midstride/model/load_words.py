"""The `run` text of a composable node: its class, and what `ros2 component load` takes besides.

run component "demo_nodes_cpp::Talker -r chatter:=/chat -e enable_rosout:=false" package "demo_nodes_cpp"
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from immutables import Map

_REMAP: Final = ("-r", "--remap-rule")
_EXTRA: Final = ("-e", "--extra-argument")
# What `ros2 component load` takes as well, and where a specification states it.
_ELSEWHERE: Final[Mapping[str, str]] = {
    **dict.fromkeys(("-p", "--parameter"), "state it in `parameters { … }`"),
    **dict.fromkeys(("-n", "--node-name", "--node-namespace"), "omit it: the node is named after its role"),
}
_RULE: Final = re.compile(r"[^:=\s]+:=\S+")


@dataclass(frozen=True, slots=True)
class LoadWords:
    """The class ``plugin``, its ``remaps`` (``FROM:=TO``), and the arguments that only component containers take."""

    plugin: str
    remaps: tuple[str, ...] = ()
    extra: Map[str, bool | int | float | str] = field(default_factory=Map)

    @classmethod
    def of(cls, run: str) -> LoadWords:
        """Raises ValueError, in words, with what to write instead."""
        words = iter(shlex.split(run))
        plugin = next(words, "")
        if not plugin or plugin.startswith("-"):
            raise ValueError("it does not begin with a class, such as `demo_nodes_cpp::Talker`")
        remaps: list[str] = []
        extra: dict[str, bool | int | float | str] = {}
        for option, value in _options(words):
            if option in _REMAP:
                remaps.append(value)
            else:
                name, found = extra_argument(value)
                extra[name] = found
        return cls(plugin, tuple(remaps), Map(extra))


def is_intra_process(run: str | None) -> bool:
    """Return whether the `run` text of a composable node asks for communication within the process."""
    try:
        return LoadWords.of(run or "").extra.get("use_intra_process_comms") is True
    except ValueError:
        return False  # reported as a command that cannot be read


def _options(words: Iterator[str]) -> Iterator[tuple[str, str]]:
    for option in words:
        if option in _ELSEWHERE:
            raise ValueError(f"`{option}` does not belong there: {_ELSEWHERE[option]}")
        if option not in (*_REMAP, *_EXTRA):
            raise ValueError(f"`{option}` is none of `-r FROM:=TO` and `-e NAME:=VALUE`, which may follow the class")
        value = next(words, "")
        if option in _REMAP and not _RULE.fullmatch(value):
            raise ValueError(f"`{option}` is followed by `{value}`, and not by `FROM:=TO`")
        yield option, value


def extra_argument(word: str) -> tuple[str, bool | int | float | str]:
    """The name and the value of an extra argument, `NAME:=VALUE`. Raises ValueError, in words."""
    if not _RULE.fullmatch(word):
        raise ValueError(f"`-e` is followed by `{word}`, and not by `NAME:=VALUE`")
    name, _, text = word.partition(":=")
    return name, _value(text)


def _value(text: str) -> bool | int | float | str:
    """The value of an extra argument, as YAML has it. Raises ValueError."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if text[0] in "[{":
        raise ValueError(f"`{text}` is not one value, which an extra argument has")
    if (number := _integer(text)) is not None:
        if not -(2**63) <= number < 2**63:
            raise ValueError(f"`{text}` is beyond the integers of 64 bits")
        return number
    try:
        return float(text)
    except ValueError:
        return text


def _integer(text: str) -> int | None:
    try:
        return int(text)
    except ValueError:
        return None
