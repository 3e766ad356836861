"""The findings of an import: what it could not take over, or had to assume, at its place in a launch file."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, Final

from midstride.lang.source import Span
from midstride.model.printable import on_one_line

# The kinds of findings, each with what it means for the specification.
KINDS: Final = {
    "argument": "an argument has no value, or one that is not among its choices",
    "package": "a package is not here, or has no such executable",
    "include": "a launch file is not here, or may not be read; what it starts is left out",
    "python": "a launch file in Python is not carried out, or failed; what it starts is left out",
    "condition": "a condition has no known value; what it guards is left out",
    "substitution": "a substitution has no known value; what needs it is left out",
    "command": "a command is not carried out, or has failed; what needs its output is left out",
    "later": "a process is started later, or by an event; here it follows what it waits for",
    "composable": "a component, or its container, has lost something; or it is left out (`--containers omit`)",
    "parameters": "a parameter or a parameter file is left out",
    "name": "a node has no name, or one that another node or the language uses; it gets another name",
    "lifecycle": "a lifecycle manager manages nodes, and goes on, or Midstride does, as of a node that no manager has",
    "once": "a program ends when it has done its work, and launch lets it: it is `once`, and not run again",
    "program": "the launch file does not say that a program is a node",
    "host": "a machine of a launch file becomes a host, or something of it is left out",
    "restart": "a process is restarted in another way, or without end, as launch does",
    "refused": "ROS's launch refuses the whole launch file for it; here the rest is read",
    "unsupported": "an element or an attribute has no counterpart and is left out",
}


class UnknownValue(Exception):
    """A value depends on what cannot be known here. ``kind`` is one of KINDS."""

    def __init__(self, message: str, kind: str = "substitution") -> None:
        super().__init__(message)
        self.kind = kind


class Tolerated(UnknownValue):
    """launch refuses the value, and an import reads it as it is meant."""


@dataclass(frozen=True, slots=True)
class ImportFinding:
    """One finding. ``kind`` is one of KINDS. ``left_out``: something is not in the specification, not only assumed."""

    kind: str
    message: str
    span: Span
    left_out: bool = True

    @property
    def place(self) -> str:
        """The file and the line."""
        return f"{self.span.source.name}:{self.span.source.position(self.span.start)[0]}"

    def to_json(self) -> dict[str, Any]:
        line, column = self.span.source.position(self.span.start)
        return {
            "kind": self.kind,
            "message": self.message,
            "left_out": self.left_out,
            "file": self.span.source.name,
            "line": line,
            "column": column,
        }

    def __str__(self) -> str:
        return on_one_line(f"{self.place}: {self.kind}: {self.message}")


class ImportFindings:
    """The findings of one import, each once, in the order in which they are met. ``launcher``: what starts the file."""

    def __init__(self, launcher: str = "launch") -> None:
        self._launcher = launcher
        self._found: dict[tuple[object, ...], ImportFinding] = {}
        self._refused: set[tuple[str, int, str]] = set()

    def add(self, kind: str, message: str, span: Span, left_out: bool = True) -> None:
        """Something that is left out, or only assumed."""
        finding = ImportFinding(kind, message, span, left_out)
        self._found.setdefault((str(finding), span.source.name, span.start), finding)

    def refuse(self, reason: str, span: Span, left_out: bool = False, of: str = "") -> None:
        """Name something for which the launcher refuses the launch file; ``of``: of what."""
        self._refused.add((span.source.name, span.start, reason))
        what = f"{of}: {reason}" if of else reason
        self.add("refused", f"{self._launcher} refuses this file: {what}", span, left_out)

    def leave_out(self, what: str, error: UnknownValue, span: Span) -> None:
        """Name something that is left out because of ``error``, unless launch refuses the launch file for just that."""
        if (span.source.name, span.start, str(error)) not in self._refused:
            self.add(error.kind, f"{what} is left out: {error}", span)

    def add_once(self, kind: str, message: str, span: Span) -> None:
        """Name what is assumed, and is the same wherever it is met, at the first place only."""
        self._found.setdefault((kind, message), ImportFinding(kind, message, span, left_out=False))

    def counts(self, left_out: bool | None = None) -> dict[str, int]:
        """The number of findings of each kind, the most frequent first; of those left out or not, if stated."""
        kinds = (each.kind for each in self if left_out is None or each.left_out is left_out)
        return dict(Counter(kinds).most_common())

    def __iter__(self) -> Any:
        return iter(self._found.values())

    def __len__(self) -> int:
        return len(self._found)
