"""The base of the parser: inspecting tokens and expecting them.

An error is reported where it is found, and the statement is abandoned (:class:`Panic`, as in panic-mode recovery).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final, TypeVar

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.lexer import Tokens, string_value, truncated
from midstride.lang.source import Span
from midstride.lang.syntax import Name, Number, SourceLayout
from midstride.model.component_rules import MAX_NUMBER
from midstride.model.near_miss import nearest

T = TypeVar("T")

# The statements of a node's restart policy.
RESPAWN_WORDS: Final = ("respawn", "respawn_delay", "respawn_max_retries", "respawn_fallback")
# The keywords that start statements, with the blocks they belong to. They cannot be declared names: lists need no
# comma, so the next statement must be distinguishable from the next name.
KEYWORD_PLACES: Final[Mapping[str, str]] = {
    "environment": "at the top level, in a namespace, in a component or in a container",
    **dict.fromkeys("system include contract topic service".split(), "at the top level or in a namespace"),
    **dict.fromkeys("resource component node namespace".split(), "at the top level or in a namespace"),
    **dict.fromkeys("keep limit order timing changes".split(), "at the top level or in a namespace"),
    "action": "at the top level, in a namespace or in a component",
    **dict.fromkeys(("container", "host"), "at the top level or in a namespace"),
    "run": "in a component or in a container",
    **dict.fromkeys("holds input output server client allows functionality".split(), "in a component"),
    "parameters": "in a component, in a mode, in a node or at the top level",
    **dict.fromkeys(RESPAWN_WORDS, "in a node"),
    **dict.fromkeys("uses produces mode".split(), "in a functionality"),
    "assume": "in a mode",
    "guarantee": "in a mode or in the environment",
}
# Ports and the like may be called `host`: it begins a statement at the top level only before a name and `{`.
RESERVED: Final = frozenset(KEYWORD_PLACES) - {"host"}

# Punctuation that other languages have where this one has the other, or none (`node: talker`).
_MISTAKEN_SIGNS: Final = {":", "="}

# Converting longer numbers takes time and adds no precision.
_MAX_DIGITS: Final = 40


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

    def is_keyword(self, index: int) -> bool:
        if self.kinds[index] != "name":
            return False
        if self.texts[index] == "host":
            return self.kinds[index + 1] == "name" and self.kinds[index + 2] == "{"
        return self.texts[index] in RESERVED

    def _line(self, index: int) -> int:
        return self.tokens.source.position(self.tokens.starts[index])[0]

    def _place(self) -> Span:
        """The place where something is missing: the current token, or after the previous one if that ends its line."""
        if self.i and (self.kinds[self.i] == "end" or self._line(self.i) > self._line(self.i - 1)):
            end = self.span(self.i - 1).end
            return Span(self.tokens.source, end, end)
        return self.span()

    def rest_of_line(self) -> str:
        """The text from here to the end of the line, the next statement or the next brace."""
        start, line = self.i, self._line(self.i)
        end = start + 1
        while self.kinds[end] not in {"end", "{", "}"} and not self.is_keyword(end) and self._line(end) == line:
            end += 1
        return self.span(start).to(self.span(end - 1)).text

    def found(self) -> str:
        """A description of the current token."""
        kind, text = self.kinds[self.i], self.texts[self.i]
        if kind == "end":
            return "end of file"
        if kind == "string":
            return "a string"
        return f"keyword `{text}`" if self.is_keyword(self.i) else f"`{truncated(text)}`"

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
        if self.kinds[self.i] not in follow or self.is_keyword(self.i):
            raise panic

    def expect_word(self, word: str, after: str) -> None:
        if not self.accept_word(word):
            raise self.fail(f"`{word}` {after}")

    def take(self) -> Name:
        """The current token, as it is written."""
        self.i += 1
        return Name(self.texts[self.i - 1], self.span(self.i - 1))

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
        return self.take()

    def topic(self, what: str) -> Name:
        """A name or path."""
        return self.take() if self.kinds[self.i] == "path" else self.name(what, (":", "{", ".", "->", "<-"))

    def text(self, what: str) -> Name:
        """The value of a string."""
        if self.kinds[self.i] != "string":
            raise self.fail(what)
        text, span = self.take()
        return Name(string_value(text), span)

    def number(self, what: str) -> Number:
        if self.kinds[self.i] != "number":
            raise self.fail(what)
        text, span = self.take()
        return self._bounded(Number(float(text) if len(text) <= _MAX_DIGITS else float("inf"), span))

    def _bounded(self, number: Number, unit: str = "") -> Number:
        """``number``, or another one in its place if it is too large."""
        if abs(number.value) <= MAX_NUMBER:
            return number
        message = "this number is too large, or written with too many digits"
        self.reporter.report("E126", number.span, message, help=f"the maximum is 1e18{unit}")
        return Number(1.0, number.span)

    def quantity(self, what: str, units: Mapping[str, float]) -> Number:
        """A number with a unit, converted to the base unit, which is the first of ``units``."""
        number = self.number(what)
        unit = self.texts[self.i]
        if self.kinds[self.i] == "name" and unit in units:
            converted = Number(number.value * units[unit], number.span.to(self.take().span))
            return self._bounded(converted, f" {next(iter(units))}")
        close = next((known for known in units if known.lower() == unit.lower()), None)
        example = f"write `{number.span.text} {close or next(iter(units))}`"
        if self.kinds[self.i] != "name" or unit in RESERVED or (close is None and self._starts_item(self.i)):
            self.reporter.report("E127", number.span, f"{what} needs a unit", help=example)
        else:
            help = example if close else f"{example}; known units: {', '.join(units)}"
            self.reporter.report("E127", self.take().span, f"`{unit}` is not a valid unit for {what}", help=help)
        return number

    def _starts_item(self, at: int) -> bool:
        """Return whether the name at ``at`` is not a unit: what follows it makes it the name of something else."""
        return self.kinds[at + 1] in {"number", ":", "=", "<-", "->", ".", ","}

    def items(self, close: str) -> Iterator[None]:
        """Once for each item of a list, up to the sign that closes it; commas between the items are optional."""
        first = True
        while not self.accept(close):
            if not first:
                self.accept(",")
                if self.accept(close):
                    return
                self.layout.items.add(self.i)
            first = False
            yield

    def sequence(self, read: Callable[[], T], continues: Callable[[int], bool]) -> tuple[T, ...]:
        """Collect what ``read`` reads, until no further item starts at a token; commas between the items are
        optional.
        """
        found = [read()]
        while continues(at := self.i + (self.kinds[self.i] == ",")):
            self.i = at
            self.layout.items.add(at)
            found.append(read())
        return tuple(found)

    def names(self, what: str) -> tuple[Name, ...]:
        """One or more names."""
        return self.sequence(
            lambda: self.name(what),
            lambda at: self.kinds[at] == "name" and not self.is_keyword(at) and not self._is_misspelt_statement(at),
        )

    def _is_misspelt_statement(self, at: int) -> bool:
        """Return whether the name at ``at`` probably starts a statement: `mod normal {`."""
        heads = self.kinds[at + 1] == "name" and self.kinds[min(at + 2, len(self.kinds) - 1)] in {"{", ":"}
        return heads and nearest(self.texts[at], RESERVED) is not None
