"""Reading plain values (dicts, lists, numbers, words) with a path, noting every fault and going on.

A :class:`Reader` never raises: what is wrong is noted once, and a stand-in is returned that lets the
rest be read. So one pass finds every independent fault.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from typing import Any

from midstride.errors import SpecificationError
from midstride.model.diagnostics import Problem, suggestion


class JsonObject(dict[str, Any]):
    """An object read from text, which remembers the keys that were written twice."""

    duplicates: tuple[str, ...] = ()


def parse_json(text: str) -> Any:
    """The value of a JSON text. Raises SpecificationError with line and column, never anything else."""
    try:
        return json.loads(text, object_pairs_hook=_pairs)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise SpecificationError([Problem("E001", (), f"not JSON: {error.msg} at {where}")]) from None
    except RecursionError:
        raise SpecificationError([Problem("E001", (), "not JSON: nested too deep")]) from None
    except ValueError as error:  # an integer of thousands of digits
        raise SpecificationError([Problem("E004", (), f"not JSON: {error}")]) from None


def _pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = JsonObject(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        found.duplicates = tuple(dict.fromkeys(key for index, key in enumerate(keys) if key in keys[:index]))
    return found


def told(value: object) -> str:
    """What kind of JSON value this is, with the value where it is short."""
    if value is None:
        return "null"
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, (list, tuple)):
        return "a list"
    if not isinstance(value, (bool, int, float, str)):
        return type(value).__name__
    name = "a boolean" if isinstance(value, bool) else "a text" if isinstance(value, str) else "a number"
    shown = json.dumps(value) if not isinstance(value, int) or abs(value) < 10**20 else ""
    return f"{name} ({shown})" if 0 < len(shown) <= 40 else name


class Reader:
    """A value at a path."""

    __slots__ = ("faults", "path", "value")

    def __init__(self, value: object, path: tuple[str, ...], faults: list[Problem]) -> None:
        self.value = value
        self.path = path
        self.faults = faults

    def fault(self, code: str, message: str, help: str = "", *, at: tuple[str, ...] = ()) -> None:
        self.faults.append(Problem(code, self.path + at, message, help))

    def _expected(self, what: str, help: str = "") -> None:
        self.fault("E001", f"{what} is expected, this is {told(self.value)}", help)

    def inside(self, key: str, value: object) -> Reader:
        return Reader(value, (*self.path, key), self.faults)

    # -- objects and lists -------------------------------------------------------------------------

    def entries(self, what: str) -> Iterator[tuple[str, Reader]]:
        """The entries of an object whose keys are names of the user's."""
        if not isinstance(self.value, dict):
            self._expected(f"an object of {what}")
            return
        for key in getattr(self.value, "duplicates", ()):
            self.fault("E007", f"`{key}` is written twice", "JSON would keep the last one alone", at=(key,))
        for key, value in self.value.items():
            if isinstance(key, str):
                yield key, self.inside(key, value)
            else:
                self.fault("E001", f"the key {key!r} is not a text")

    def keys(self, what: str, required: Iterable[str], optional: Iterable[str]) -> dict[str, Reader]:
        """The known keys of an object that are there. Unknown and missing ones are faults."""
        required = tuple(required)
        known = (*required, *optional)
        if not isinstance(self.value, dict):
            self._expected(what, f"an object with {', '.join(known)}")
            return {}
        found: dict[str, Reader] = {}
        for key, reader in self.entries(what):
            if key in known:
                found[key] = reader
            else:
                self.fault("E002", f"{what} has no key `{key}`", suggestion(key, known), at=(key,))
        for key in required:
            if key not in found:
                self.fault("E003", f"{what} needs the key `{key}`")
        return found

    def items(self, what: str) -> list[Reader]:
        if not isinstance(self.value, (list, tuple)):
            self._expected(f"a list of {what}", "write [ … ]")
            return []
        return [self.inside(str(index), value) for index, value in enumerate(self.value)]

    def texts(self, what: str) -> tuple[str, ...]:
        """The texts of a list; the empty text stands for what is none, so that the others keep their places."""
        return tuple(item.name() or "" for item in self.items(what))

    # -- values ------------------------------------------------------------------------------------

    def text(self, what: str = "a text") -> str | None:
        if isinstance(self.value, str):
            return self.value
        self._expected(what)
        return None

    def name(self, what: str = "a text") -> str | None:
        """A text with something in it."""
        text = self.text(what)
        if text == "":
            self.fault("E006", f"{what} cannot be empty")
            return None
        return text

    def word(self, words: tuple[str, ...]) -> str | None:
        """One of a few words."""
        text = self.text(f"one of {', '.join(words)}")
        if text is not None and text not in words:
            self.fault("E005", f"`{text}` is not one of {', '.join(words)}", suggestion(text, words))
            return None
        return text

    def boolean(self) -> bool | None:
        if isinstance(self.value, bool):
            return self.value
        self._expected("true or false")
        return None

    def finite(self, what: str) -> int | float | None:
        """A number as it is written: an integer stays one."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self._expected(what)
            return None
        try:
            if math.isfinite(float(value)):
                return value
        except OverflowError:
            value = "an integer of that size"
        self.fault("E004", f"{what} is expected, {value} is none")
        return None

    def number(self, what: str, *, zero: bool = False) -> float | None:
        """A positive number (or zero, where that has a meaning)."""
        value = self.finite(what)
        if value is None:
            return None
        if value < 0 or (value == 0 and not zero):
            self.fault("E004", f"{what} must be {'at least' if zero else 'more than'} 0, it is {value}")
            return None
        return float(value)

    def count(self, what: str, *, zero: bool = False) -> int | None:
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            self._expected(f"{what} (a whole number)")
            return None
        if self.value < 0 or (self.value == 0 and not zero):
            self.fault("E004", f"{what} must be at least {0 if zero else 1}, it is {self.value}")
            return None
        return self.value
