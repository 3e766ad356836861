"""The language service for editors, independent of a protocol: diagnostics, hover, definition, rename, completion,
formatting.

Open files are read from their buffers, all others from disk. A fragment is analysed as part of the system that
includes it: an open one, or one in its folder, in the parent folder or in the workspace.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from midstride.lang.completion import Completion, complete
from midstride.lang.declarations import Declarations
from midstride.lang.diagnostic_text import Diagnostic
from midstride.lang.hover import hover
from midstride.lang.index import Occurrence, SymbolIndex
from midstride.lang.lexer import is_topic_name
from midstride.lang.load import Loaded, load
from midstride.lang.message_types import MessageTypes
from midstride.lang.printer import format_text
from midstride.lang.source import Source, Span
from midstride.lang.source_files import FileReader, Unreadable, read_text, resolve_name

# How many files per folder are searched for the system that includes a fragment.
_MAX_SEARCHED: Final = 200


@dataclass(frozen=True)
class Analysis:
    """A loaded system and its symbols."""

    root: Path
    loaded: Loaded

    @cached_property
    def index(self) -> SymbolIndex:
        return SymbolIndex(Declarations() if self.loaded.resolved is None else self.loaded.resolved.declarations)

    def source(self, path: Path) -> Source | None:
        wanted = os.path.normpath(path)
        sources = (source for source in self.loaded.files if source.path is not None)
        return next((source for source in sources if os.path.normpath(source.path or "") == wanted), None)


class LanguageService:
    """Holds the buffers of open files. ``roots`` are further folders to search for systems."""

    def __init__(
        self, read: FileReader = read_text, messages: Callable[[], MessageTypes | None] = lambda: None
    ) -> None:
        self.roots: list[Path] = []
        self.buffers: dict[str, str] = {}
        self._read_disk = read
        self._messages = messages
        self._analyses: dict[str, Analysis] = {}

    def open(self, path: Path, text: str) -> None:
        """Use ``text`` as the contents of a file from now on."""
        self.buffers[os.path.normpath(path)] = text
        self._analyses.clear()

    def close(self, path: Path) -> None:
        """Read the file from disk again."""
        self.buffers.pop(os.path.normpath(path), None)
        self._analyses.clear()

    def _read(self, path: Path) -> str:
        buffer = self.buffers.get(os.path.normpath(path))
        return self._read_disk(path) if buffer is None else buffer

    def analysis(self, path: Path) -> Analysis:
        """The system that a file belongs to."""
        key = os.path.normpath(path)
        if key not in self._analyses:
            found = Analysis(path, self._load(path))
            if any(diagnostic.code == "E106" for diagnostic in found.loaded.diagnostics):
                systems = (Analysis(root, self._load(root)) for root in self._candidates(path))
                found = next((system for system in systems if system.source(path) is not None), found)
            self._analyses[key] = found
        return self._analyses[key]

    def _load(self, path: Path) -> Loaded:
        return load(path, read=self._read, messages=self._messages())

    def _candidates(self, path: Path) -> Iterable[Path]:
        """Files that may include ``path``, open ones first."""
        listed: dict[str, None] = dict.fromkeys(self.buffers)
        for folder in (path.parent, path.parent.parent, *self.roots):
            try:
                names = sorted(os.listdir(folder))[:_MAX_SEARCHED]
            except OSError:
                continue
            listed.update(dict.fromkeys(os.path.normpath(folder / name) for name in names if name.endswith(".stride")))
        for name in listed:
            if name == os.path.normpath(path):
                continue
            try:
                text = self._read(Path(name))
            except (Unreadable, OSError):
                continue
            if "system" in text and "include" in text:
                yield Path(name)

    def diagnostics(self, path: Path) -> dict[Path, list[Diagnostic]]:
        """The diagnostics of the system that ``path`` belongs to, by file; a file without any has an empty list."""
        analysis = self.analysis(path)
        files = (source.path for source in analysis.loaded.files)
        found: dict[Path, list[Diagnostic]] = {file: [] for file in (*files, path) if file is not None}
        for diagnostic in analysis.loaded.diagnostics:
            span = diagnostic.span
            place = analysis.root if span is None or span.source.path is None else span.source.path
            found.setdefault(place, []).append(diagnostic)
        return found

    def _at(self, path: Path, line: int, column: int) -> tuple[Analysis, Occurrence | None]:
        analysis = self.analysis(path)
        source = analysis.source(path)
        return analysis, None if source is None else analysis.index.at(source, source.offset(line, column))

    def hover(self, path: Path, line: int, column: int) -> str | None:
        """A description of the symbol at a position (both from 1) in Markdown, such as its contract or initial mode."""
        analysis, found = self._at(path, line, column)
        resolved = analysis.loaded.resolved
        if found is None or resolved is None:
            return None
        if found.symbol.kind == "contract":
            contract = resolved.contracts.named(found.symbol.name)
            return f"**contract** `{found.symbol.name}`\n\n`{contract}`" if contract is not None else None
        return hover(found.symbol, resolved.specification, runnable=analysis.loaded.specification is not None)

    def definition(self, path: Path, line: int, column: int) -> Span | None:
        """The declaration of the symbol at a position."""
        analysis, found = self._at(path, line, column)
        declared = None if found is None else analysis.index.declaration(found.symbol)
        return None if declared is None else declared.span

    def references(self, path: Path, line: int, column: int) -> list[Span]:
        """All occurrences of the symbol at a position."""
        analysis, found = self._at(path, line, column)
        return [] if found is None else [place.span for place in analysis.index.occurrences_of(found.symbol)]

    def rename(self, path: Path, line: int, column: int, name: str) -> list[tuple[Span, str]]:
        """The edits that rename the symbol at a position. Raises ValueError if the name is invalid for it, or if the
        rename would cause an error."""
        analysis, found = self._at(path, line, column)
        if found is None or analysis.index.declaration(found.symbol) is None:
            raise ValueError("there is no symbol to rename at this position")
        if not is_topic_name(name) or (("/" in name or name.startswith("~")) and found.symbol.kind != "topic"):
            raise ValueError(f"`{name}` is not a valid {found.symbol.kind} name")
        edits: dict[tuple[str, int], tuple[Span, str]] = {}
        for symbol, occurrence in analysis.index.declared_together(found.symbol):
            namespace = found.namespace if symbol == found.symbol else occurrence.namespace
            for place in analysis.index.occurrences_of(symbol):
                text = _renamed(place, name, "/" + resolve_name(namespace, name))
                edits[place.span.source.name, place.span.start] = place.span, text
        self._check_renamed(analysis, list(edits.values()))
        return list(edits.values())

    def _check_renamed(self, analysis: Analysis, edits: list[tuple[Span, str]]) -> None:
        """Raises ValueError if the edits cause a new error, such as a duplicate name."""
        texts: dict[str, str] = {}
        for span, text in sorted(edits, key=lambda edit: -edit[0].start):
            key = os.path.normpath(span.source.path or span.source.name)
            whole = texts.get(key, span.source.text)
            texts[key] = whole[: span.start] + text + whole[span.end :]

        def read(path: Path) -> str:
            edited = texts.get(os.path.normpath(path))
            return self._read(path) if edited is None else edited

        known = {diagnostic.message for diagnostic in analysis.loaded.diagnostics}
        for diagnostic in load(analysis.root, read=read, messages=self._messages()).diagnostics:
            if diagnostic.severity == "error" and diagnostic.message not in known:
                raise ValueError(f"the rename would cause an error: {diagnostic.message}")

    def complete(self, path: Path, line: int, column: int) -> list[Completion]:
        """The words that can be written at a position."""
        analysis = self.analysis(path)
        source = analysis.source(path)
        if source is None or analysis.loaded.resolved is None:
            return []
        return complete(source, source.offset(line, column), analysis.loaded.resolved)

    def format(self, path: Path) -> str | None:
        """The canonical text of a file; None if it cannot be parsed or read."""
        try:
            return format_text(self._read(path), str(path)).text
        except (Unreadable, OSError):
            return None


def _renamed(occurrence: Occurrence, name: str, full: str) -> str:
    """The new text of an occurrence of a symbol renamed to ``name``; ``full`` is a topic's full name, which is written
    relative to the namespace where it was so before."""
    text = occurrence.span.text
    if occurrence.symbol.kind == "node":
        return f"{text[: text.rfind('/') + 1]}{name}"
    if occurrence.symbol.kind != "topic":
        return name
    prefix = f"/{occurrence.namespace}/" if occurrence.namespace else "/"
    return full if text.startswith("/") else full.removeprefix(prefix)
