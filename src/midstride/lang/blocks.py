"""Blocks of statements, and how reading goes on after an error.

A statement that cannot be read is reported and skipped; its block goes on with the next one. What was skipped is
remembered, so that a name which was perhaps declared there is not called undefined later. A brace too few or too many
is told from a misplaced statement by indentation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.lexer import Tokens
from midstride.lang.token_stream import BELONGS, RESERVED, Panic, TokenStream
from midstride.model.near_miss import nearest

Handlers = Mapping[str, Callable[[], None]]


class BlockParser(TokenStream):
    """The part of the parser that reads blocks."""

    def __init__(self, tokens: Tokens, reporter: Reporter) -> None:
        super().__init__(tokens, reporter)
        self.lost: set[str] = set()
        self._open: list[tuple[int, Handlers]] = []  # the first token and the handlers of each block that is open

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
        opened_line, indentation = self._opening()
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
        line, column = self.tokens.source.position(self.tokens.starts[at])
        before = self.tokens.source.line(line)[: column - 1]
        return bool(before.strip()) or len(before) > self._opening()[1]

    def _opening(self) -> tuple[int, int]:
        """The line on which the innermost block's declaration begins, and how far it is indented."""
        line, _ = self.tokens.source.position(self.tokens.starts[self._open[-1][0]])
        text = self.tokens.source.line(line)
        return line, len(text) - len(text.lstrip())

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
