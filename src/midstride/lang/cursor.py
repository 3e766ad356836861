"""What the parser's parts share: looking at tokens, expecting them, and going on after an error.

An error is reported where it is found and the statement it stands in is given up (:class:`Panic`);
the block goes on with its next statement. What was skipped is remembered, so that a name which was
perhaps declared there is not called undefined later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.lexer import Tokens, string_value
from midstride.lang.source import Span
from midstride.lang.suggest import nearest
from midstride.lang.syntax import Layout, Name, Number

# The words that begin a statement, with the block they belong to. No declared name may be one: lists need no comma, so
# the next statement must be told from the next name.
BELONGS: Final[Mapping[str, str]] = {
    **dict.fromkeys(
        "system include contract topic resource environment component node namespace keep limit order timing".split(),
        "at the outermost level or in a namespace",
    ),
    **dict.fromkeys("run holds input output allows functionality".split(), "in a component"),
    "parameters": "in a component, in a node or at the outermost level",
    **dict.fromkeys("uses produces mode".split(), "in a functionality"),
    "assume": "in a mode",
    "guarantee": "in a mode or in the environment",
}
RESERVED: Final = frozenset(BELONGS)

Handlers = Mapping[str, Callable[[], None]]

# Signs that other languages have where this one has the other, or none (`node: talker`).
_CONFUSED: Final = {":", "="}

# Longer digits say nothing more, and turning them into numbers takes time.
_LONGEST_NUMBER: Final = 40
_LARGEST: Final = 1e18


class Panic(Exception):
    """The statement at hand cannot be read on; its error has been reported."""


class Cursor:
    """A place in the tokens, and how to move on from it."""

    def __init__(self, tokens: Tokens, reporter: Reporter) -> None:
        self.tokens = tokens
        self.reporter = reporter
        self.kinds = tokens.kinds
        self.texts = tokens.texts
        self.i = 0
        self.layout = Layout()
        self.lost: set[str] = set()
        self._open: list[tuple[int, Handlers]] = []  # the first token and the handlers of each block that is open

    # -- looking -------------------------------------------------------------------------------------

    def span(self, index: int | None = None) -> Span:
        return self.tokens.span(self.i if index is None else index)

    def since(self, start: int) -> Span:
        """From the token ``start`` to the last one read."""
        return self.span(start).to(self.span(max(start, self.i - 1)))

    def at_word(self, word: str) -> bool:
        return self.texts[self.i] == word and self.kinds[self.i] == "name"

    def _line(self, index: int) -> int:
        return self.tokens.source.position(self.tokens.starts[index])[0]

    def _place(self) -> Span:
        """Where something is missing: at the token found, or just behind the last one if that ends its line."""
        if self.i and (self.kinds[self.i] == "end" or self._line(self.i) > self._line(self.i - 1)):
            end = self.span(self.i - 1).end
            return Span(self.tokens.source, end, end)
        return self.span()

    def rest_of_line(self) -> str:
        """What stands from here to the end of the line, or to where the next statement or a brace begins."""
        start, line = self.i, self._line(self.i)
        end = start + 1
        while (
            self.kinds[end] not in {"end", "{", "}"}
            and not (self.kinds[end] == "name" and self.texts[end] in RESERVED)
            and self._line(end) == line
        ):
            end += 1
        return self.span(start).to(self.span(end - 1)).text

    def found(self) -> str:
        """The token found, in words."""
        kind, text = self.kinds[self.i], self.texts[self.i]
        if kind == "end":
            return "the end of the file"
        if kind == "string":
            return "a text"
        shown = text if len(text) <= 40 else text[:39] + "…"
        return f"the word `{shown}`" if kind == "name" and text in RESERVED else f"`{shown}`"

    # -- reading ---------------------------------------------------------------------------------------

    def fail(self, expected: str, help: str | None = None) -> Panic:
        """Report that something else was expected here, and yield the exception to raise."""
        self.reporter.report("E120", self._place(), f"expected {expected}, found {self.found()}", help=help)
        return Panic()

    def accept(self, sign: str) -> bool:
        if self.kinds[self.i] == sign:
            self.i += 1
            return True
        return False

    def accept_word(self, word: str) -> bool:
        if self.at_word(word):
            self.i += 1
            return True
        return False

    def expect(self, sign: str, before: str, follow: tuple[str, ...] = ()) -> None:
        """Read ``sign``. Where one of ``follow`` stands instead, it was merely forgotten, and reading goes on; so it
        does behind `:` for `=` and the other way round."""
        if self.kinds[self.i] == sign:
            self.i += 1
            return
        panic = self.fail(f"`{sign}` {before}")
        if {sign, self.kinds[self.i]} == _CONFUSED:
            self.i += 1
            return
        if self.kinds[self.i] not in follow or (self.kinds[self.i] == "name" and self.texts[self.i] in RESERVED):
            raise panic

    def expect_word(self, word: str, after: str) -> None:
        if not self.accept_word(word):
            raise self.fail(f"`{word}` {after}")

    def name(self, what: str, then: tuple[str, ...] = ()) -> Name:
        """A declared name, or a use of one. A word of the language is none, and is taken for one only before
        ``then``."""
        if self.kinds[self.i] != "name":
            if self.kinds[self.i] in _CONFUSED and self.kinds[self.i + 1] == "name":
                self.fail(what, "leave it out")
                self.i += 1
                return self.name(what, then)
            number = self.kinds[self.i] == "number"
            raise self.fail(what, "a name begins with a letter" if number else None)
        text = self.texts[self.i]
        if text in RESERVED:
            if self.kinds[self.i + 1] not in then:
                raise self.fail(what)
            message = f"`{text}` is a word of the language and cannot be {what}"
            self.reporter.report("E125", self.span(), message, help=f"choose another name, such as `{text}_1`")
        self.i += 1
        return Name(text, self.span(self.i - 1))

    def topic(self, what: str) -> Name:
        """A name or path."""
        if self.kinds[self.i] == "path":
            self.i += 1
            return Name(self.texts[self.i - 1], self.span(self.i - 1))
        return self.name(what, (":", "{", ".", "->", "<-"))

    def text(self, what: str) -> Name:
        """What stands in double quotes."""
        if self.kinds[self.i] != "string":
            raise self.fail(what)
        self.i += 1
        return Name(string_value(self.texts[self.i - 1]), self.span(self.i - 1))

    def number(self, what: str) -> Number:
        if self.kinds[self.i] != "number":
            raise self.fail(what)
        self.i += 1
        text, span = self.texts[self.i - 1], self.span(self.i - 1)
        value = float(text) if len(text) <= _LONGEST_NUMBER else float("inf")
        if abs(value) > _LARGEST:
            self.reporter.report(
                "E126", span, "this number is too large, or written with too many digits", help="at most 1e18"
            )
            value = 1.0
        return Number(value, span)

    def quantity(self, what: str, units: Mapping[str, float]) -> Number:
        """A number with its unit, in the base unit, which is the first of ``units``."""
        number = self.number(what)
        base = next(iter(units))
        unit = self.texts[self.i]
        example = f"write `{number.span.text} {base}`"
        if self.kinds[self.i] != "name" or (unit not in units and unit in RESERVED):
            self.reporter.report("E127", number.span, f"{what} needs its unit", help=example)
            return number
        if unit not in units:
            close = next((known for known in units if known.lower() == unit.lower()), None)
            if close is None and self.kinds[self.i + 1] in {"number", ":", "=", "<-", "->", ".", ","}:
                self.reporter.report("E127", number.span, f"{what} needs its unit", help=example)
                return number
            help = f"write `{number.span.text} {close}`" if close else f"{example}; known units: {', '.join(units)}"
            self.reporter.report("E127", self.span(), f"`{unit}` is no unit of {what}", help=help)
            self.i += 1
            return number
        self.i += 1
        return Number(number.value * units[unit], number.span.to(self.span(self.i - 1)))

    def names(self, what: str) -> tuple[Name, ...]:
        """One or more names, with or without commas between them."""
        found = [self.name(what)]
        while True:
            comma = self.kinds[self.i] == ","
            at = self.i + comma
            if self.kinds[at] != "name" or self.texts[at] in RESERVED or self._is_misspelt_statement(at):
                return tuple(found)
            self.i = at
            self.layout.items.add(at)
            found.append(self.name(what))

    def _is_misspelt_statement(self, at: int) -> bool:
        """Whether the name at ``at`` rather begins a statement: `mod normal {`."""
        heads = self.kinds[at + 1] == "name" and self.kinds[min(at + 2, len(self.kinds) - 1)] in {"{", ":"}
        return heads and nearest(self.texts[at], RESERVED) is not None

    # -- blocks ------------------------------------------------------------------------------------------

    def block(
        self, what: str, first: int, handlers: Handlers, other: Callable[[], bool] | None = None, separator: str = "   "
    ) -> frozenset[str]:
        """Read ``{ … }``: statements by their first word, or by ``other``, which says whether it took one.

        ``first`` is the token that the whole declaration begins with. Yields
        the first words of the statements that could not be read.
        """
        opened = self.i
        if not self.accept("{"):
            panic = self.fail(f"`{{` to open {what}")
            if self.texts[self.i] not in handlers:
                raise panic
            opened -= 1  # it was merely forgotten
        self._open.append((first, handlers))
        lost = self.statements(what, opened, handlers, other, separator)
        self._open.pop()
        self.layout.blocks[opened] = self.i - 1
        return lost

    def statements(
        self,
        what: str,
        opened: int | None,
        handlers: Handlers,
        other: Callable[[], bool] | None = None,
        separator: str = "   ",
    ) -> frozenset[str]:
        """The statements up to the closing brace, which is read; up to the end of the file where ``opened`` is None."""
        lost: set[str] = set()
        while not self.reporter.is_full:
            if self.kinds[self.i] == ",":
                self.i += 1
            kind, text, start = self.kinds[self.i], self.texts[self.i], self.i
            if kind == "end":
                if opened is not None:
                    self._not_closed(what, opened, "the end of the file")
                    return frozenset({*lost, text})
                return frozenset(lost)
            if kind == "}":
                self.i += 1
                if opened is not None:
                    if self._closes_too_early(start, handlers):
                        message = f"this `}}` closes {what}, and `{self.texts[self.i]}`, which belongs in it, follows"
                        self.reporter.report("E124", self.span(start), message, help="leave it out")
                        continue
                    return frozenset(lost)
                self.reporter.report("E124", self.span(start), "this `}` closes nothing", help="leave it out")
                continue
            self.layout.statements[start] = separator
            try:
                if kind == "name" and text in handlers:
                    handlers[text]()
                elif other is not None and other():
                    pass
                elif kind == "name" and text in RESERVED:
                    if opened is not None and self._ends_block(start):
                        self._not_closed(what, opened, f"`{text}`")
                        del self.layout.statements[start]
                        return frozenset(lost)
                    self.reporter.report("E122", self.span(), f"`{text}` belongs {BELONGS[text]}, not in {what}")
                    raise Panic
                else:
                    self._unknown(what, handlers)
            except Panic:
                lost.add(text)
                self._skip(start)
        self.i = len(self.kinds) - 1
        return frozenset({*lost, ""})

    def _unknown(self, what: str, handlers: Handlers) -> None:
        """A word that begins no statement here: taken for the one it is nearest to, if the rest may fit."""
        text = self.texts[self.i]
        meant = nearest(text, handlers) if self.kinds[self.i] == "name" else None
        if meant is None:
            known = ", ".join(f"`{word}`" for word in handlers)
            raise self.fail(f"a statement of {what}", f"known here: {known}" if known else None)
        message = f"`{text}` begins no statement of {what}"
        self.reporter.report("E121", self.span(), message, help=f"did you mean `{meant}`?")
        handlers[meant]()

    def _ends_block(self, at: int) -> bool:
        """Whether the word at ``at``, unknown in this block, goes on with an outer one: so it was meant if it stands
        no deeper."""
        line, column = self.tokens.source.position(self.tokens.starts[at])
        first = self._open[-1][0]
        opened_line, _ = self.tokens.source.position(self.tokens.starts[first])
        opening = self.tokens.source.line(opened_line)
        indentation = len(opening) - len(opening.lstrip())
        outer = any(self.texts[at] in handlers for _, handlers in self._open[:-1]) or BELONGS[
            self.texts[at]
        ].startswith("at")
        return outer and (line == opened_line or column <= indentation + 1)

    def _closes_too_early(self, at: int, handlers: Handlers) -> bool:
        """Whether the brace at ``at`` is one too many: what follows fits this block and no outer one, and the brace
        does not stand where the one that closes the block would."""
        word = self.texts[self.i]
        if self.kinds[self.i] != "name" or word not in handlers:
            return False
        if any(word in outer for _, outer in self._open[:-1]) or "at the outermost" in BELONGS[word]:
            return False
        opened_line, _ = self.tokens.source.position(self.tokens.starts[self._open[-1][0]])
        line, column = self.tokens.source.position(self.tokens.starts[at])
        before = self.tokens.source.line(line)[: column - 1]
        opening = self.tokens.source.line(opened_line)
        return bool(before.strip()) or len(before) > len(opening) - len(opening.lstrip())

    def _not_closed(self, what: str, opened: int, before: str) -> None:
        note = Note("it is opened here", self.span(opened))
        self.reporter.report(
            "E123", self._place(), f"{what} is not closed: expected `}}` before {before}", notes=[note]
        )

    def _skip(self, start: int) -> None:
        """Go to where the next statement may begin; at least one token on from ``start``."""
        depth = 0
        for index in range(start, self.i):
            self._lose(index)
            depth += (self.kinds[index] == "{") - (self.kinds[index] == "}")  # more than 0 in a set of values
        while (kind := self.kinds[self.i]) != "end":
            if kind == "}":
                if depth == 0:
                    return
                depth -= 1
                if depth == 0:
                    self.i += 1
                    return
            elif kind == "{":
                depth += 1
            elif depth == 0 and kind == "name" and self.texts[self.i] in RESERVED and self.i > start:
                return
            self._lose(self.i)
            self.i += 1

    def _lose(self, index: int) -> None:
        if self.kinds[index] in {"name", "path"}:
            self.lost.add(self.texts[index])
