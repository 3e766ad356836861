"""Specifications in JSON, with their problems reported at their places in the text."""

from __future__ import annotations

import json
import re

from midstride.codec.reading import parse_json, strict_json
from midstride.codec.specification_form import decode_specification
from midstride.errors import SpecificationError
from midstride.lang.diagnostic_text import Diagnostic, Reporter, in_order
from midstride.lang.source import Source, Span
from midstride.model.diagnostics import Problem
from midstride.model.specification import Specification
from midstride.model.specification_checks import check

_SIGNIFICANT = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,]|[^\s{}\[\]:,"]+')


def check_json(source: Source) -> tuple[Specification | None, tuple[Diagnostic, ...]]:
    """The specification that a JSON text says, or None where it is in error; and the diagnostics."""
    reporter = Reporter()
    specification: Specification | None = None
    problems: tuple[Problem, ...]
    try:
        specification = decode_specification(parse_json(source.text))
        problems = check(specification)
    except SpecificationError as error:
        problems = tuple(problem for problem in error.problems if isinstance(problem, Problem))
    places = places_of(source) if problems else {}
    for problem in problems:
        place = _syntax_place(source, places) if not problem.subject else None
        paths = (problem.subject[:length] for length in range(len(problem.subject), -1, -1))
        place = place or next((places[path] for path in paths if path in places), None)
        reporter.report(problem.code, place, problem.message, help=problem.help or None, file=source.name)
    return (None if reporter.has_errors else specification), in_order(reporter.found)


def _syntax_place(source: Source, places: dict[tuple[str, ...], Span]) -> Span | None:
    """The place where the text stops being JSON, or is nested too deep; None where neither is so."""
    try:
        strict_json(source.text)
    except json.JSONDecodeError as error:
        return Span(source, error.pos, error.pos)
    except RecursionError:
        return next(reversed(places.values()))
    except ValueError:
        pass
    return None


def places_of(source: Source) -> dict[tuple[str, ...], Span]:
    """The place of each value of a JSON text, by its path; an entry of an object is at its key."""
    places: dict[tuple[str, ...], Span] = {}
    # Each open container: its path, whether it is an object, the key or index to come.
    stack: list[tuple[tuple[str, ...], bool, str | int]] = []
    key: tuple[str, Span] | None = None
    for match in _SIGNIFICANT.finditer(source.text):
        text, span = match.group(), Span(source, match.start(), match.end())
        if text in "}]":
            if stack:
                stack.pop()
            key = None
            continue
        if text == ",":
            if stack and not stack[-1][1]:
                path, _, index = stack[-1]
                stack[-1] = (path, False, int(index) + 1)
            key = None
            continue
        if text == ":":
            continue
        if stack and stack[-1][1] and key is None:
            try:
                key = (str(json.loads(text)), span)
            except ValueError:
                return places
            continue
        path = (*stack[-1][0], key[0] if key is not None else str(stack[-1][2])) if stack else ()
        places[path] = key[1] if key is not None else span
        if text in "{[":
            if len(stack) > 64:
                return places
            stack.append((path, text == "{", 0))
            key = None
    return places
