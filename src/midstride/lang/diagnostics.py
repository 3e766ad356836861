"""Diagnostics: what is wrong, where, and what to write instead; as text with carets, and as JSON.

The codes are those of :mod:`midstride.lang.catalogue`; ``E…`` is an error, ``W…`` a warning.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from midstride.lang.source import Span

Severity = Literal["error", "warning"]

# A text that is no Stride at all would yield an error for each of its lines.
MAX_DIAGNOSTICS = 100
# A line of a megabyte is not shown as one.
_SHOWN = 160


@dataclass(frozen=True, slots=True)
class Note:
    """A second place that has to do with a diagnostic, such as the first declaration of a name."""

    message: str
    span: Span


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One thing that is wrong. ``span`` is None where no text exists to point at (``file`` names it then).

    ``follows`` tells what it leads to, where that is not plain.
    """

    code: str
    message: str
    span: Span | None = None
    help: str | None = None
    notes: tuple[Note, ...] = ()
    file: str = ""
    follows: str | None = None

    @property
    def severity(self) -> Severity:
        return "warning" if self.code.startswith("W") else "error"

    @property
    def file_name(self) -> str:
        return self.span.source.name if self.span is not None else self.file

    @property
    def position(self) -> tuple[int, int]:
        """Line and column, from 1; the beginning of the file where there is no place."""
        return self.span.source.position(self.span.start) if self.span is not None else (1, 1)

    def to_json(self) -> dict[str, Any]:
        """The form of interfaces.md; ``end_line``, ``end_column`` (not included) and ``notes`` beside it."""
        line, column = self.position
        end_line, end_column = self.span.source.position(self.span.end) if self.span is not None else (line, column)
        return {
            "code": self.code,
            "severity": self.severity,
            "file": self.file_name,
            "line": line,
            "column": column,
            "end_line": end_line,
            "end_column": end_column,
            "message": self.message,
            "help": self.help,
            "follows": self.follows,
            "notes": [_note_json(note) for note in self.notes],
        }

    def render(self) -> str:
        """The diagnostic as a person reads it: heading, the line with a caret under the place, notes, help."""
        line, column = self.position
        parts = [f"{self.severity}[{self.code}]: {self.message}"]
        if self.span is None:
            parts.append(f"  --> {self.file_name}")
        else:
            parts.append(f"  --> {self.file_name}:{line}:{column}")
            parts.extend(_excerpt(self.span))
        for note in self.notes:
            note_line, note_column = note.span.source.position(note.span.start)
            parts.append(f"  note: {note.message}: {note.span.source.name}:{note_line}:{note_column}")
        if self.follows:
            parts.append(f"  so: {self.follows}")
        if self.help:
            parts.append(f"  help: {self.help}")
        return "\n".join(parts)

    def __str__(self) -> str:
        line, column = self.position
        told = f"{self.file_name}:{line}:{column}: {self.severity}[{self.code}]: {self.message}"
        return f"{told} ({self.help})" if self.help else told


def _note_json(note: Note) -> dict[str, Any]:
    line, column = note.span.source.position(note.span.start)
    return {"message": note.message, "file": note.span.source.name, "line": line, "column": column}


def _excerpt(span: Span) -> list[str]:
    line, column = span.source.position(span.start)
    text = span.source.line(line)
    length = max(1, min(span.end, span.start + len(text) - column + 1) - span.start)
    before, cut = column - 1, ""
    if len(text) > _SHOWN:
        first = max(0, min(before - _SHOWN // 2, len(text) - _SHOWN))
        cut = "…" if first else ""
        text, before = text[first : first + _SHOWN], before - first
        length = max(1, min(length, _SHOWN - before))
    margin = " " * len(str(line))
    shown = "".join(_visible(character) for character in text)
    lead = " " * sum(_width(character) for character in cut + text[:before])
    carets = "^" * max(1, sum(_width(character) for character in text[before : before + length]))
    return [f" {margin} |", f" {line} | {cut}{shown}", f" {margin} | {lead}{carets}"]


def _visible(character: str) -> str:
    """A tab as a blank and a control character as a sign, so that carets stand where they belong."""
    if character == "\t":
        return " "
    return "\ufffd" if unicodedata.category(character) in {"Cc", "Cs", "Cf"} else character


def _width(character: str) -> int:
    if unicodedata.combining(character):
        return 0
    return 2 if unicodedata.east_asian_width(character) in {"W", "F"} else 1


class Reporter:
    """Collects diagnostics: each once, at most :data:`MAX_DIAGNOSTICS` errors, in the order of the text at the end."""

    __slots__ = ("_seen", "dropped", "found")

    def __init__(self) -> None:
        self.found: list[Diagnostic] = []
        self.dropped = False
        self._seen: set[tuple[str, str, int]] = set()

    def report(
        self,
        code: str,
        span: Span | None,
        message: str,
        *,
        help: str | None = None,
        notes: Iterable[Note] = (),
        file: str = "",
        follows: str | None = None,
    ) -> None:
        """Add a diagnostic; a second one of that code at the same place is the same one told twice."""
        key = (code, span.source.name if span else file + message, span.start if span else 0)
        if key in self._seen:
            return
        if self.is_full:
            self.dropped = True
            return
        self._seen.add(key)
        self.found.append(Diagnostic(code, message, span, help, tuple(notes), file, follows))

    @property
    def is_full(self) -> bool:
        """Whether so much is wrong already that looking further helps nobody."""
        return len(self.found) >= MAX_DIAGNOSTICS

    def finish(self, file: str) -> None:
        """Say so where there was more to report than is kept."""
        if self.dropped or self.is_full:
            self.found.append(Diagnostic("E199", "too much is wrong here to show it all", None, file=file))

    @property
    def has_errors(self) -> bool:
        return any(diagnostic.severity == "error" for diagnostic in self.found)


def in_order(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """By file in the order in which files first occur, then by place."""
    listed = list(diagnostics)
    rank: dict[str, int] = {}
    for diagnostic in listed:
        rank.setdefault(diagnostic.file_name, len(rank))
    return tuple(sorted(listed, key=lambda d: (d.code == "E199", rank[d.file_name], d.position, d.code)))


def has_errors(diagnostics: Iterable[Diagnostic]) -> bool:
    return any(diagnostic.severity == "error" for diagnostic in diagnostics)


def render(diagnostics: Iterable[Diagnostic]) -> str:
    """All of them as text, and a last line that counts them; empty where there are none."""
    listed = list(diagnostics)
    if not listed:
        return ""
    errors = sum(diagnostic.severity == "error" for diagnostic in listed)
    warnings = len(listed) - errors
    counts = [_count(errors, "error"), _count(warnings, "warning")]
    return "\n\n".join([*(d.render() for d in listed), ", ".join(c for c in counts if c)])


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}" if number else ""
