"""Reading JSON into forms, with every fault at its path.

msgspec stops at the first fault. So a document that it refuses is read a second time, by a
:class:`~midstride.codec.fault_finder.FaultFinder`, which walks the same class definitions and goes on after each fault.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Final, TypeVar

import msgspec
from msgspec import inspect

from midstride.codec.fault_finder import FaultFinder, RepeatedKeys
from midstride.errors import SpecificationError
from midstride.model.diagnostics import Problem, independent

F = TypeVar("F", bound=msgspec.Struct)
T = TypeVar("T")

# An escape in a JSON text; `lone` is a surrogate without the other half of its pair, which no output can encode.
_ESCAPE: Final = re.compile(
    r"\\(?:u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|(?P<lone>u[dD][89a-fA-F][0-9a-fA-F]{2})|.)"
)


def strict_json(text: str, pairs: Callable[[list[tuple[str, Any]]], Any] | None = None) -> Any:
    """The value of a JSON text without lone surrogates. Raises as ``json.loads`` does."""
    value = json.loads(text, object_pairs_hook=pairs)
    for escape in _ESCAPE.finditer(text):
        if escape["lone"] is not None:
            raise json.JSONDecodeError(f"\\{escape['lone']} is half of a surrogate pair", text, escape.start())
    return value


def parse_json(text: str) -> Any:
    """The value of a JSON text. Raises SpecificationError with line and column, never anything else.

    Where a key is written twice in an object, the outermost value is marked so that :func:`decode` reports it.
    """
    found: list[RepeatedKeys] = []

    def pairs(entries: list[tuple[str, Any]]) -> dict[str, Any]:
        plain = dict(entries)
        if len(plain) == len(entries):
            return plain
        marked = RepeatedKeys(plain)
        keys = [key for key, _ in entries]
        marked.repeated = tuple(dict.fromkeys(key for index, key in enumerate(keys) if key in keys[:index]))
        found.append(marked)
        return marked

    try:
        value = strict_json(text, pairs)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise SpecificationError([Problem("E001", (), f"not JSON: {error.msg} at {where}")]) from None
    except RecursionError:
        raise SpecificationError([Problem("E001", (), "not JSON: nested too deep")]) from None
    except ValueError as error:  # an integer of thousands of digits
        raise SpecificationError([Problem("E004", (), f"not JSON: {error}")]) from None
    return RepeatedKeys(value) if found and type(value) is dict else value


def decode(
    document: object, form: type[F], build: Callable[[F], T], names: Callable[[T], Iterable[Problem]] = lambda _: ()
) -> T:
    """The value that ``build`` makes of the document's form.

    ``names`` finds the faults in the names of that value. Raises SpecificationError with every fault of form and of
    names, each with its path. ``build`` may raise ValueError for faults that only it can find.
    """
    faults: list[Problem] = []
    value: T | None = None
    if not isinstance(document, RepeatedKeys):
        try:
            value = build(msgspec.convert(document, form))
        except (msgspec.ValidationError, ValueError, RecursionError):
            value = None
    if value is None:
        finder = FaultFinder()
        stand_in = finder.read(document, _type_of(form), ())
        faults, value = finder.faults, build(stand_in)
    faults = independent(faults, names(value))
    if faults:
        raise SpecificationError(faults)
    return value


def under(key: str, problems: Iterable[Problem]) -> Iterable[Problem]:
    """The problems of a part, as those of the whole in which it is under ``key``."""
    for problem in problems:
        declared = (key, *problem.declared) if problem.declared else ()
        yield replace(problem, subject=(key, *problem.subject), declared=declared)


def decode_form(document: object, form: type[F]) -> F:
    """The form that a document has. Raises SpecificationError with every fault of form."""
    return decode(document, form, lambda found: found)


_type_of = functools.cache(inspect.type_info)
