"""Blocks of statements, and recovery after errors.

A statement that cannot be parsed is reported and skipped; its block continues with the next one. The names in it are
remembered, so that a name it may have declared is not reported as unknown later. Indentation decides between a missing
or extra brace and a misplaced statement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.lexer import Tokens
from midstride.lang.token_stream import KEYWORD_PLACES, Panic, TokenStream
from midstride.model.near_miss import nearest

# What reads the rest of a statement, by its keyword; the argument is the index of the keyword.
Handlers = Mapping[str, Callable[[int], object]]


class BlockParser(TokenStream):
    """The part of the parser for blocks."""

    def __init__(self, tokens: Tokens, reporter: Reporter) -> None:
        super().__init__(tokens, reporter)
        self.skipped: set[str] = set()
        self._open: list[tuple[int, Handlers]] = []  # the first token and the handlers of each open block

    def block(
        self, what: str, first: int, handlers: Handlers, other: Callable[[], bool] | None = None, separator: str = "   "
    ) -> frozenset[str]:
        """Parse ``{ … }``: each statement by the handler of its keyword, or by ``other``, which returns whether it did.

        ``first`` is the first token of the whole declaration. Returns the first words of the skipped statements.
        """
        opened = self.i
        if not self.accept("{"):
            panic = self.fail(f"`{{` to open {what}")
            if self.texts[self.i] not in handlers:
                raise panic
            opened -= 1  # only the brace is missing
        self._open.append((first, handlers))
        skipped = self.statements(what, opened, handlers, other, separator)
        self._open.pop()
        self.layout.blocks[opened] = self.i - 1
        return skipped

    def statements(
        self,
        what: str,
        opened: int | None,
        handlers: Handlers,
        other: Callable[[], bool] | None = None,
        separator: str = "   ",
    ) -> frozenset[str]:
        """The statements up to and including the closing brace; to the end of the file if ``opened`` is None."""
        skipped: set[str] = set()
        while not self.reporter.is_full:
            if self.kinds[self.i] == ",":
                self.i += 1
            kind, text, start = self.kinds[self.i], self.texts[self.i], self.i
            if kind == "end":
                if opened is not None:
                    self._report_unclosed(what, opened, "the end of the file")
                    return frozenset({*skipped, text})
                return frozenset(skipped)
            if kind == "}":
                self.i += 1
                message = "unmatched `}`"
                if opened is not None:
                    if not self._closes_too_early(start, handlers):
                        return frozenset(skipped)
                    message = f"this `}}` closes {what} before `{self.texts[self.i]}`, which belongs inside it"
                self.reporter.report("E124", self.span(start), message, help="remove it")
                continue
            self.layout.statements[start] = separator
            try:
                if kind == "name" and text in handlers:
                    self.i += 1
                    handlers[text](start)
                elif other is not None and other():
                    pass
                elif self.is_keyword(start):
                    if opened is not None and self._ends_block(start):
                        self._report_unclosed(what, opened, f"`{text}`")
                        del self.layout.statements[start]
                        return frozenset(skipped)
                    self.reporter.report("E122", self.span(), f"`{text}` belongs {KEYWORD_PLACES[text]}, not in {what}")
                    raise Panic
                else:
                    self._unknown_statement(what, handlers)
            except Panic:
                skipped.add(text)
                self._skip_statement(start)
        self.i = len(self.kinds) - 1
        return frozenset({*skipped, ""})

    def _unknown_statement(self, what: str, handlers: Handlers) -> None:
        """Handle a word that starts no statement here: as the nearest keyword, if there is one."""
        text = self.texts[self.i]
        meant = nearest(text, handlers) if self.kinds[self.i] == "name" else None
        if meant is None:
            allowed = ", ".join(f"`{word}`" for word in handlers)
            raise self.fail(f"a statement in {what}", f"allowed here: {allowed}" if allowed else None)
        message = f"unknown statement `{text}` in {what}"
        self.reporter.report("E121", self.take().span, message, help=f"did you mean `{meant}`?")
        handlers[meant](self.i - 1)

    def _ends_block(self, at: int) -> bool:
        """Return whether the keyword at ``at``, unknown in this block, continues an outer one: if it is indented no
        deeper.
        """
        line, column = self.tokens.source.position(self.tokens.starts[at])
        opened_line, indentation = self._opening_line()
        outer = any(self.texts[at] in handlers for _, handlers in self._open[:-1]) or KEYWORD_PLACES[
            self.texts[at]
        ].startswith("at")
        return outer and (line == opened_line or column <= indentation + 1)

    def _closes_too_early(self, at: int, handlers: Handlers) -> bool:
        """Return whether the brace at ``at`` is superfluous.

        Then what follows fits this block and no outer one, and the brace is not indented as the closing brace of the
        block would be.
        """
        word = self.texts[self.i]
        if self.kinds[self.i] != "name" or word not in handlers:
            return False
        if any(word in outer for _, outer in self._open[:-1]) or "at the top level" in KEYWORD_PLACES.get(word, ""):
            return False
        line, column = self.tokens.source.position(self.tokens.starts[at])
        before = self.tokens.source.line(line)[: column - 1]
        return bool(before.strip()) or len(before) > self._opening_line()[1]

    def _opening_line(self) -> tuple[int, int]:
        """The line of the innermost block's declaration, and its indentation."""
        line, _ = self.tokens.source.position(self.tokens.starts[self._open[-1][0]])
        text = self.tokens.source.line(line)
        return line, len(text) - len(text.lstrip())

    def _report_unclosed(self, what: str, opened: int, before: str) -> None:
        note = Note("opened here", self.span(opened))
        self.reporter.report(
            "E123", self._place(), f"{what} is not closed: expected `}}` before {before}", notes=[note]
        )

    def _skip_statement(self, start: int) -> None:
        """Advance to where the next statement may start, at least one token after ``start``."""
        depth = 0
        for index in range(start, self.i):
            self._remember_name(index)
            depth += (self.kinds[index] == "{") - (self.kinds[index] == "}")  # positive within a set of values
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
            elif depth == 0 and self.is_keyword(self.i) and self.i > start:
                return
            self._remember_name(self.i)
            self.i += 1

    def _remember_name(self, index: int) -> None:
        if self.kinds[index] in {"name", "path"}:
            self.skipped.add(self.texts[index])
