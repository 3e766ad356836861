"""The base of the parser: inspecting tokens and expecting them.

An error is reported where it is found, and the statement is abandoned (:class:`Panic`, as in panic-mode recovery).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from midstride.lang.diagnostics import Reporter
from midstride.lang.lexer import Tokens, string_value
from midstride.lang.source import Span
from midstride.lang.syntax import Name, Number, SourceLayout
from midstride.model.near_miss import nearest

# The keywords that start statements, with the blocks they belong to. They cannot be declared names: lists need no
# comma, so the next statement must be distinguishable from the next name.
KEYWORD_PLACES: Final[Mapping[str, str]] = {
    **dict.fromkeys(
        "system include contract topic resource environment component node namespace keep limit order timing".split(),
        "at the top level or in a namespace",
    ),
    **dict.fromkeys("run holds input output allows functionality".split(), "in a component"),
    "parameters": "in a component, in a node or at the top level",
    **dict.fromkeys("uses produces mode".split(), "in a functionality"),
    "assume": "in a mode",
    "guarantee": "in a mode or in the environment",
}
RESERVED: Final = frozenset(KEYWORD_PLACES)

# Punctuation that other languages have where this one has the other, or none (`node: talker`).
_MISTAKEN_SIGNS: Final = {":", "="}

# Converting longer numbers takes time and adds no precision.
_MAX_DIGITS: Final = 40
_MAX_NUMBER: Final = 1e18


class Panic(Exception):
    """The current statement cannot be parsed further; its error has been reported."""


class TokenStream:
    """The tokens and the current position in them."""

    def __init__(self, tokens: Tokens, reporter: Reporter) -> None:
        self.tokens = tokens
        self.reporter = reporter
        self.kinds = tokens.kinds
        self.texts = tokens.texts
        self.i = 0
        self.layout = SourceLayout()

    # -- inspecting -------------------------------------------------------------------------------------

    def span(self, index: int | None = None) -> Span:
        return self.tokens.span(self.i if index is None else index)

    def since(self, start: int) -> Span:
        """The range from token ``start`` to the last token read."""
        return self.span(start).to(self.span(max(start, self.i - 1)))

    def at_word(self, word: str) -> bool:
        return self.texts[self.i] == word and self.kinds[self.i] == "name"

    def _line(self, index: int) -> int:
        return self.tokens.source.position(self.tokens.starts[index])[0]

    def _place(self) -> Span:
        """Where something is missing: at the current token, or after the previous one if that ends its line."""
        if self.i and (self.kinds[self.i] == "end" or self._line(self.i) > self._line(self.i - 1)):
            end = self.span(self.i - 1).end
            return Span(self.tokens.source, end, end)
        return self.span()

    def rest_of_line(self) -> str:
        """The text from here to the end of the line, the next statement or the next brace."""
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
        """A description of the current token."""
        kind, text = self.kinds[self.i], self.texts[self.i]
        if kind == "end":
            return "end of file"
        if kind == "string":
            return "a string"
        shown = text if len(text) <= 40 else text[:39] + "…"
        return f"keyword `{shown}`" if kind == "name" and text in RESERVED else f"`{shown}`"

    # -- reading ---------------------------------------------------------------------------------------

    def fail(self, expected: str, help: str | None = None) -> Panic:
        """Report what was expected here; returns the exception to raise."""
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
        """Read ``sign``. If one of ``follow`` comes instead, or `:` for `=` or vice versa, report it and continue."""
        if self.kinds[self.i] == sign:
            self.i += 1
            return
        panic = self.fail(f"`{sign}` {before}")
        if {sign, self.kinds[self.i]} == _MISTAKEN_SIGNS:
            self.i += 1
            return
        if self.kinds[self.i] not in follow or (self.kinds[self.i] == "name" and self.texts[self.i] in RESERVED):
            raise panic

    def expect_word(self, word: str, after: str) -> None:
        if not self.accept_word(word):
            raise self.fail(f"`{word}` {after}")

    def name(self, what: str, then: tuple[str, ...] = ()) -> Name:
        """A declared name, or a use of one. A keyword is an error, and is taken for a name only before ``then``."""
        if self.kinds[self.i] != "name":
            if self.kinds[self.i] in _MISTAKEN_SIGNS and self.kinds[self.i + 1] == "name":
                self.fail(what, "remove it")
                self.i += 1
                return self.name(what, then)
            number = self.kinds[self.i] == "number"
            raise self.fail(what, "names start with a letter" if number else None)
        text = self.texts[self.i]
        if text in RESERVED:
            if self.kinds[self.i + 1] not in then:
                raise self.fail(what)
            message = f"`{text}` is a keyword and cannot be used as {what}"
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
        """The value of a string."""
        if self.kinds[self.i] != "string":
            raise self.fail(what)
        self.i += 1
        return Name(string_value(self.texts[self.i - 1]), self.span(self.i - 1))

    def number(self, what: str) -> Number:
        if self.kinds[self.i] != "number":
            raise self.fail(what)
        self.i += 1
        text, span = self.texts[self.i - 1], self.span(self.i - 1)
        value = float(text) if len(text) <= _MAX_DIGITS else float("inf")
        if abs(value) > _MAX_NUMBER:
            self.reporter.report(
                "E126", span, "this number is too large, or written with too many digits", help="the maximum is 1e18"
            )
            value = 1.0
        return Number(value, span)

    def quantity(self, what: str, units: Mapping[str, float]) -> Number:
        """A number with a unit, converted to the base unit, which is the first of ``units``."""
        number = self.number(what)
        base = next(iter(units))
        unit = self.texts[self.i]
        example = f"write `{number.span.text} {base}`"
        if self.kinds[self.i] != "name" or (unit not in units and unit in RESERVED):
            self.reporter.report("E127", number.span, f"{what} needs a unit", help=example)
            return number
        if unit not in units:
            close = next((known for known in units if known.lower() == unit.lower()), None)
            if close is None and self.kinds[self.i + 1] in {"number", ":", "=", "<-", "->", ".", ","}:
                self.reporter.report("E127", number.span, f"{what} needs a unit", help=example)
                return number
            help = f"write `{number.span.text} {close}`" if close else f"{example}; known units: {', '.join(units)}"
            self.reporter.report("E127", self.span(), f"`{unit}` is not a valid unit for {what}", help=help)
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
        """Whether the name at ``at`` probably starts a statement: `mod normal {`."""
        heads = self.kinds[at + 1] == "name" and self.kinds[min(at + 2, len(self.kinds) - 1)] in {"{", ":"}
        return heads and nearest(self.texts[at], RESERVED) is not None
