"""Known message types, so that misspelt types and fields are found before anything runs.

The checker uses :class:`MessageTypes`. :func:`installed` reads the interface files of installed packages
(``share/<package>/msg``, ``srv`` and ``action``, the layout of ROS 2 and ROS 1) and, for messages of other packages,
the type store of ``rosbags``. No ROS library is imported.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from midstride.model.contract import canonical_type

_FIELD: Final = re.compile(r"\s*([A-Za-z][\w/]*)(<=\d+)?(\[[^\]]*\])?\s+([A-Za-z]\w*)\s*(=?)")
_NUMBERS: Final = "byte char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float32 float64 octet float double"
_KINDS: Final = {
    **dict.fromkeys(_NUMBERS.split(), "number"),
    **dict.fromkeys(("string", "wstring"), "text"),
    **dict.fromkeys(("bool", "boolean"), "boolean"),
    **dict.fromkeys(("time", "duration"), "unknown"),  # primitive types of ROS 1 that have fields
    "Header": "std_msgs/msg/Header",
}
_LARGEST: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class MessageDefinition:
    """The fields of a message type by kind (``number``, ``text``, ``boolean``, ``list`` or a message type), and its
    constants with their values as written."""

    name: str
    fields: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, str] = field(default_factory=dict)


class MessageTypes(Protocol):
    """Looks up message types."""

    def message(self, name: str) -> MessageDefinition | None:
        """The type with that canonical name; None if it is unknown."""

    def types(self, package: str, folder: str = "msg") -> Iterable[str]:
        """The names (``Image``) of the package's types in that folder, ``msg``, ``srv`` or ``action``; empty if the
        package is unknown."""


class MissingField(NamedTuple):
    """A field that does not exist: the message it would be in, its name, and the existing fields."""

    owner: str
    name: str
    known: tuple[str, ...]


def field_kind(messages: MessageTypes, message: MessageDefinition, path: str) -> str | MissingField:
    """The kind of the field at the dotted ``path``; ``unknown`` if a type on the way is unknown."""
    kind = message.name
    for name in path.split("."):
        if "/" not in kind:
            return kind if kind == "unknown" else MissingField(f"a {kind}", name, ())
        found = message if kind == message.name else messages.message(kind)
        if found is None:
            return "unknown"
        if name not in found.fields:
            return MissingField(found.name, name, tuple(found.fields))
        kind = found.fields[name]
    return kind


class InstalledTypes:
    """The message types of the packages under ``folders``, and those of ``fallback``, made when it is needed first, for
    other packages."""

    def __init__(self, folders: Iterable[Path], fallback: Callable[[], MessageTypes]) -> None:
        self._folders = tuple(folders)
        self._fallback = cache(fallback)
        self._folder: Callable[[str, str], Path | None] = cache(self._find_folder)
        self.message = cache(self._find)

    def types(self, package: str, folder: str = "msg") -> Iterable[str]:
        found = self._folder(package, folder)
        if found is None:
            return self._fallback().types(package, folder)
        return sorted(path.stem for path in found.glob(f"*.{folder}"))

    def _find_folder(self, package: str, folder: str) -> Path | None:
        candidates = (share / package / folder for share in self._folders)
        return next((each for each in candidates if any(each.glob(f"*.{folder}"))), None)

    def _find(self, name: str) -> MessageDefinition | None:
        package, kind, rest = canonical_type(name).split("/")
        folder = self._folder(package, kind)
        if folder is None:
            return self._fallback().message(name)
        try:
            with open(folder / f"{rest}.{kind}", encoding="utf-8", errors="replace") as stream:
                text = stream.read(_LARGEST)
        except OSError:
            return None
        if kind != "msg":
            return MessageDefinition(name)  # of which no field can be constrained
        return MessageDefinition(name, parse_fields(text, package), parse_constants(text))


def parse_fields(text: str, package: str) -> dict[str, str]:
    """The fields that an interface file (``.msg``) declares."""
    fields: dict[str, str] = {}
    for line in text.splitlines():
        match = _FIELD.match(line.partition("#")[0])
        if match is None or match[5]:
            continue  # not a declaration, or a constant
        base, array, name = match[1], match[3], match[4]
        fields[name] = "list" if array else _kind(base, package)
    return fields


def parse_constants(text: str) -> dict[str, str]:
    """The constants that an interface file declares."""
    matches = (_FIELD.match(line) for line in text.splitlines())
    return {match[4]: match.string[match.end() :].partition("#")[0].strip() for match in matches if match and match[5]}


def _kind(base: str, package: str) -> str:
    return _KINDS.get(base) or canonical_type(base if "/" in base else f"{package}/{base}")


class _Rosbags:
    """The type store of ``rosbags``: the messages of the standard packages, without a ROS installation."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._fields = get_typestore(Stores.ROS2_KILTED).fielddefs

    def message(self, name: str) -> MessageDefinition | None:
        definition = self._fields.get(name)
        if definition is None:
            return None
        constants, fields = definition
        return MessageDefinition(
            name, {field: _rosbags_kind(kind) for field, kind in fields}, {c: str(value) for c, _, value in constants}
        )

    def types(self, package: str, folder: str = "msg") -> Iterable[str]:
        prefix = f"{package}/{folder}/"
        return sorted(name.removeprefix(prefix) for name in self._fields if name.startswith(prefix))


def _rosbags_kind(kind: object) -> str:
    node, detail = kind  # type: ignore[misc]  # a pair, by the definition of the type store
    label = node.name  # type: ignore[has-type]
    if label == "NAME":
        return str(detail)  # type: ignore[has-type]
    return _kind(detail[0], "") if label == "BASE" else "list"  # type: ignore[has-type]


def share_folders(environment: Mapping[str, str]) -> list[Path]:
    """The folders that may have message packages: the sourced ROS environment, then this interpreter's prefix."""
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    prefixes += environment.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)
    folders = [Path(prefix) / "share" for prefix in [*prefixes, sys.prefix] if prefix]
    folders += [Path(folder) for folder in environment.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if folder]
    return list(dict.fromkeys(folders))


def installed(environment: Mapping[str, str] | None = None) -> MessageTypes:
    """The installed message types; ``environment`` defaults to that of the process."""
    return InstalledTypes(share_folders(os.environ if environment is None else environment), _Rosbags)
