"""The formatter: `midstride fmt`.

Line breaks, order and comments are kept; spaces, commas and indentation are normalised. Statements on one line are
separated by three spaces, adjacent lines of one kind are aligned, and a trailing comment keeps its column if the code
leaves room. Formatting is idempotent.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from midstride.lang.diagnostic_text import Diagnostic, Reporter, in_order
from midstride.lang.parser import parse
from midstride.lang.source import Source
from midstride.lang.syntax import File

INDENT: Final = "  "
# The least space between code and a trailing comment.
_GAP: Final = 2
_NO_SPACE_AFTER: Final = frozenset({"(", "[", "."})
_NO_SPACE_BEFORE: Final = frozenset({")", "]", ".", "("})


@dataclass(frozen=True, slots=True)
class Formatted:
    """The canonical text, or None if the text cannot be parsed; ``diagnostics`` says why."""

    text: str | None
    diagnostics: tuple[Diagnostic, ...] = ()


def format_text(text: str, name: str = "<text>") -> Formatted:
    """``text`` in canonical form. Includes are not read."""
    reporter = Reporter()
    file = parse(Source(name, text, Path(name)), reporter)
    if reporter.has_errors:
        return Formatted(None, in_order(reporter.found))
    return Formatted(_Printer(file).text())


@dataclass(slots=True)
class _Line:
    """A line of the result. ``marks`` are the columns in ``text`` (after the indentation) to align, by kind."""

    indent: str
    text: str = ""
    comment: str = ""
    comment_column: int = 0
    blank_before: bool = False
    marks: list[tuple[str, int]] = field(default_factory=list)

    @property
    def width(self) -> int:
        return len(self.indent) + len(self.text)


class _Printer:
    def __init__(self, file: File) -> None:
        self.file = file
        self.tokens = file.tokens
        self.layout = file.layout
        self.source = file.tokens.source
        self.lines: list[_Line] = []
        self.closing = {close: opened for opened, close in file.layout.blocks.items()}
        self.of_token = [self.source.position(start)[0] for start in self.tokens.starts]
        self.after = self._place_comments()
        self.multi = self._multi_line_blocks()

    def text(self) -> str:
        """The formatted text."""
        self._lay_out()
        _align_marks(self.lines)
        _align_comments(self.lines)
        out: list[str] = []
        for index, line in enumerate(self.lines):
            if line.blank_before and index:
                out.append("")
            code = line.indent + line.text
            if line.comment and line.text:
                code = code.ljust(line.comment_column)
            out.append((code + line.comment).rstrip())
        return "\n".join(out) + "\n" if out else ""

    # -- structure ---------------------------------------------------------------------------------------

    def _place_comments(self) -> dict[int, list[tuple[int, int, bool]]]:
        """The comments after each token (-1: before all), as (start, end, whether on the token's line).

        A comment between a heading and its opening brace moves after the brace, which stays on the heading's line.
        """
        after: dict[int, list[tuple[int, int, bool]]] = {}
        starts, kinds, index = self.tokens.starts, self.tokens.kinds, 0
        for start, end in self.tokens.comments:
            while index < len(starts) - 1 and starts[index] < start:
                index += 1
            before = index - 1
            same_line = before >= 0 and self.source.position(start)[0] == self.of_token[before]
            if index in self.layout.blocks and kinds[index] == "{":
                before = index
            after.setdefault(before, []).append((start, end, same_line))
        return after

    def _multi_line_blocks(self) -> set[int]:
        """The opening braces of the blocks that span several lines."""
        multi: set[int] = set()
        for opened, close in self.layout.blocks.items():
            spread = close > opened + 1 and self.of_token[opened] != self.of_token[close]
            if spread or any(index in self.after for index in range(opened, close)):
                multi.add(opened)
        return multi

    def _lay_out(self) -> None:
        """Split the tokens and comments into lines."""
        kinds, texts = self.tokens.kinds, self.tokens.texts
        depth = 0
        self._comments(-1, 0)
        previous: int | None = None
        fresh = True  # whether the next token starts a line whatever its kind
        for index in range(len(kinds) - 1):
            if kinds[index] == ",":
                fresh |= self._comments(index, depth)
                continue
            opened = self.closing.get(index)
            if opened in self.multi:
                depth -= 1
            statement = index in self.layout.statements
            if previous is None or self._breaks(previous, index, fresh, statement, opened in self.multi):
                if index in self.layout.items:  # the comma stays at the end of the line
                    next(line for line in reversed(self.lines) if line.text).text += ","
                continued = not statement and opened is None
                line = _Line(INDENT * (depth + 2 * continued), texts[index])
                line.blank_before = not continued and self._blank_before(index, previous)
                self.lines.append(line)
                leading = statement
            else:
                line = self.lines[-1]
                line.text += self._between(previous, index) + texts[index]
                leading = leading and not statement
            if leading:
                self._mark(line, index)
            if index in self.multi:
                depth += 1
            fresh = self._comments(index, depth)
            previous = index

    def _breaks(self, previous: int, index: int, fresh: bool, statement: bool, closes_multi: bool) -> bool:
        """Return whether the token ``index`` starts a line."""
        if fresh or closes_multi or previous in self.multi:
            return True
        if index in self.layout.blocks or index in self.closing:
            return False
        if statement and (self.closing.get(previous) in self.multi or self._holds_multi(index)):
            return True
        return self.of_token[index] > self.of_token[previous]

    def _holds_multi(self, start: int) -> bool:
        """Return whether the statement at ``start`` contains a multi-line block."""
        index = start
        while index < len(self.tokens.kinds) - 1:
            if index in self.multi:
                return True
            if index in self.layout.blocks:
                index = self.layout.blocks[index]
            index += 1
            if index in self.layout.statements or index in self.closing:
                return False
        return False

    def _blank_before(self, index: int, previous: int | None) -> bool:
        """Return whether a blank line precedes the token; never directly inside braces."""
        if previous is None:
            inside = not self.lines
        else:
            inside = index in self.closing or (previous in self.multi and previous not in self.after)
        return not inside and self._gap_before(self.tokens.starts[index])

    def _gap_before(self, offset: int) -> bool:
        text = self.source.text
        return text.count("\n", len(text[:offset].rstrip()), offset) >= 2

    def _comments(self, index: int, depth: int) -> bool:
        """Add the comments after a token; returns whether there are any."""
        found = self.after.get(index, ())
        for number, (start, end, same_line) in enumerate(found):
            text = self.source.text[start:end].rstrip()
            if same_line and self.lines and not self.lines[-1].comment:
                self.lines[-1].comment = text
                self.lines[-1].comment_column = self.source.position(start)[1] - 1
                continue
            line = _Line(INDENT * depth, comment=text)
            first_inside = number == 0 and index in self.multi
            line.blank_before = not first_inside and self._gap_before(start)
            self.lines.append(line)
        return bool(found)

    # -- within a line -------------------------------------------------------------------------------------

    def _between(self, previous: int, index: int) -> str:
        kinds = self.tokens.kinds
        if index in self.layout.statements:
            return " " if previous in self.layout.blocks else self.layout.statements[index]
        if index in self.layout.items:
            return ", "
        is_set = kinds[previous] == "{" and previous not in self.layout.blocks
        ends_set = kinds[index] == "}" and index not in self.closing
        if is_set or ends_set or kinds[previous] in _NO_SPACE_AFTER or kinds[index] in _NO_SPACE_BEFORE:
            return ""
        return " "

    def _mark(self, line: _Line, index: int) -> None:
        kind = self.layout.marks.get(index)
        if kind is None:
            return
        if kind.endswith("{"):
            close = self.layout.blocks.get(index)
            if close is None or index in self.multi or close == index + 1:
                return
        line.marks.append((kind, len(line.text) - len(self.tokens.texts[index])))


def _align_marks(lines: list[_Line]) -> None:
    """Align the marked tokens of adjacent lines of one kind."""
    group: list[_Line] = []
    for line in lines:
        adjacent = bool(group and line.text) and not line.blank_before and group[-1].indent == line.indent
        if not (adjacent and line.marks and line.marks[0][0] == group[0].marks[0][0]):
            _align_group(group)
            group = []
        if line.marks:
            group.append(line)
    _align_group(group)


def _align_group(group: list[_Line]) -> None:
    for step in range(max((len(line.marks) for line in group), default=0)):
        having = [line for line in group if len(line.marks) > step]
        target = max(line.marks[step][1] for line in having)
        for line in having:
            at = line.marks[step][1]
            pad = target - at
            line.text = line.text[:at] + " " * pad + line.text[at:]
            line.marks = [(kind, place + pad if place >= at else place) for kind, place in line.marks]


def _align_comments(lines: list[_Line]) -> None:
    """Keep trailing comments in their columns; those that share one between two blank lines keep sharing it."""
    sharing: dict[tuple[int, int], list[_Line]] = {}
    paragraph = 0
    for line in lines:
        paragraph += line.blank_before
        if line.comment and line.text:
            sharing.setdefault((paragraph, line.comment_column), []).append(line)
    for (_, column), group in sharing.items():
        target = max(column, max(line.width for line in group) + _GAP)
        for line in group:
            line.comment_column = target
