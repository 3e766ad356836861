"""Diagnostics with their places, rendered as text with carets or as JSON.

The codes are documented in :mod:`midstride.lang.catalogue`; ``E…`` is an error, ``W…`` a warning.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from midstride.lang.source import Span
from midstride.model.diagnostics import Severity
from midstride.model.printable import on_one_line, printable
from midstride.model.wording import counted

# A file in another language would produce an error per line.
MAX_DIAGNOSTICS = 100
# How many characters of a long line are shown.
_SHOWN = 160


@dataclass(frozen=True, slots=True)
class Note:
    """A related place, such as the first declaration of a name."""

    message: str
    span: Span


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One error or warning. ``span`` is None if there is no text to point at; ``file`` names the file then.

    ``follows`` describes a consequence that is not obvious.
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
        """Line and column, starting at 1; the start of the file if there is no span."""
        return self.span.source.position(self.span.start) if self.span is not None else (1, 1)

    def to_json(self) -> dict[str, Any]:
        """The form printed by `midstride check --json`; ``end_column`` is exclusive."""
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
        """The diagnostic as text, printable: heading, source line with carets, notes, consequence, help."""
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
        return "\n".join(map(on_one_line, parts))

    def __str__(self) -> str:
        line, column = self.position
        text = f"{self.file_name}:{line}:{column}: {self.severity}[{self.code}]: {self.message}"
        return on_one_line(f"{text} ({self.help})" if self.help else text)


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
    text = text.replace("\t", " ")
    lead = " " * _width(cut + text[:before])
    carets = "^" * max(1, _width(text[before : before + length]))
    return [f" {margin} |", f" {line} | {cut}{text}", f" {margin} | {lead}{carets}"]


def _width(text: str) -> int:
    """The number of columns that ``text`` takes where it is shown."""
    return sum(_columns(character) for character in printable(text))


def _columns(character: str) -> int:
    if unicodedata.combining(character) or unicodedata.category(character) == "Cf":
        return 0
    return 2 if unicodedata.east_asian_width(character) in {"W", "F"} else 1


@dataclass(slots=True)
class Reporter:
    """Collects diagnostics, without duplicates and at most :data:`MAX_DIAGNOSTICS`."""

    found: list[Diagnostic] = field(default_factory=list)
    dropped: bool = False
    _seen: set[tuple[str, str, int]] = field(default_factory=set)

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
        """Add a diagnostic, unless one with this code at this place has been added already."""
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
        """Return whether there are so many diagnostics that looking for more is of no use."""
        return len(self.found) >= MAX_DIAGNOSTICS

    def finish(self, file: str) -> None:
        """Add a diagnostic if some were dropped."""
        if self.dropped or self.is_full:
            self.found.append(Diagnostic("E199", "too many errors; the rest are not shown", None, file=file))

    @property
    def has_errors(self) -> bool:
        return has_errors(self.found)


def in_order(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """The diagnostics by file, in order of first occurrence, then by place."""
    listed = list(diagnostics)
    files = list(dict.fromkeys(diagnostic.file_name for diagnostic in listed))
    return tuple(sorted(listed, key=lambda d: (d.code == "E199", files.index(d.file_name), d.position, d.code)))


def has_errors(diagnostics: Iterable[Diagnostic]) -> bool:
    return any(diagnostic.severity == "error" for diagnostic in diagnostics)


def render(diagnostics: Iterable[Diagnostic]) -> str:
    """All diagnostics as text, and a last line with their count; empty if there are none."""
    listed = list(diagnostics)
    if not listed:
        return ""
    numbers = {kind: sum(diagnostic.severity == kind for diagnostic in listed) for kind in ("error", "warning")}
    counts = [counted(number, kind) for kind, number in numbers.items() if number]
    return "\n\n".join([*(diagnostic.render() for diagnostic in listed), ", ".join(counts)])
