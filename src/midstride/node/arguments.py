"""The arguments of commands, checked: what comes over the wire is anybody's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from midstride.errors import CommandRefused


class Arguments:
    """Each method raises CommandRefused naming the argument that is missing or of another type."""

    def __init__(self, op: str, values: Mapping[str, Any]) -> None:
        self._op = op
        self._values = values

    def text(self, name: str) -> str:
        return str(self._get(name, str, "a word"))

    def text_or(self, name: str, default: str) -> str:
        return str(self._get(name, str, "words", default))

    def whole(self, name: str, default: int | None = None) -> int:
        return int(self._get(name, int, "a whole number", default))

    def maybe_whole(self, name: str) -> int | None:
        return None if self._values.get(name) is None else self.whole(name)

    def seconds(self, name: str, default: float | None = None) -> float:
        value = float(self._get(name, (int, float), "a number of seconds", default))
        if not value >= 0:
            raise CommandRefused(f"{self._op}: {name} must not be negative")
        return value

    def flag(self, name: str, default: bool | None = None) -> bool:
        return bool(self._get(name, bool, "true or false", default))

    def words(self, name: str) -> list[str]:
        values = self._get(name, list, "a list of words")
        if not all(isinstance(value, str) for value in values):
            raise CommandRefused(f"{self._op}: {name} must be a list of words")
        return list(values)

    def table(self, name: str) -> dict[str, Any]:
        return dict(self._get(name, Mapping, "an object"))

    def tables(self, name: str) -> list[dict[str, Any]]:
        values = self._get(name, list, "a list of objects")
        if not all(isinstance(value, Mapping) for value in values):
            raise CommandRefused(f"{self._op}: {name} must be a list of objects")
        return [dict(value) for value in values]

    def gate(self, name: str, default: str | None = None) -> bool:
        value = self._get(name, str, '"open" or "closed"', default)
        if value not in ("open", "closed"):
            raise CommandRefused(f'{self._op}: {name} must be "open" or "closed", not {value!r}')
        return bool(value == "open")

    def _get(self, name: str, kind: Any, words: str, default: Any = None) -> Any:
        value = self._values.get(name, default)
        if value is None:
            value = default
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise CommandRefused(f"{self._op}: {name} must be {words}, not {value!r}")
        return value
