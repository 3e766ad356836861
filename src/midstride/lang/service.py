"""What an editor asks of the language, apart from any protocol: diagnostics, hover, definition, rename, completion,
format.

Open files are taken from their buffers, all others from the disk. A fragment is looked at as part of the system that
includes it: one that is open, or one in its own folder or the workspace's.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from midstride.lang.completion import Completion, complete
from midstride.lang.diagnostics import Diagnostic
from midstride.lang.files import Read, Unreadable, join, read_text
from midstride.lang.hover import hover
from midstride.lang.index import Index, Occurrence
from midstride.lang.lexer import is_topic_name
from midstride.lang.load import Loaded, load
from midstride.lang.message_types import MessageTypes
from midstride.lang.printer import format_text
from midstride.lang.source import Source, Span

# How many files of a folder are looked at to find the system that includes a fragment.
_SEARCHED: Final = 200


@dataclass(slots=True)
class Analysis:
    """A system as an editor sees it."""

    root: Path
    loaded: Loaded
    index: Index | None

    def source(self, path: Path) -> Source | None:
        wanted = os.path.normpath(path)
        return next(
            (
                configuration
                for configuration in self.loaded.files
                if configuration.path is not None and os.path.normpath(configuration.path) == wanted
            ),
            None,
        )


class LanguageService:
    """Holds the buffers of open files. ``roots`` are folders in which systems are looked for."""

    def __init__(
        self,
        roots: Iterable[Path] = (),
        read: Read = read_text,
        messages: Callable[[], MessageTypes | None] = lambda: None,
    ) -> None:
        self.roots = list(roots)
        self.buffers: dict[str, str] = {}
        self._read_disk = read
        self._messages = messages
        self._analyses: dict[str, Analysis] = {}

    def open(self, path: Path, text: str) -> None:
        """Take ``text`` for the contents of a file from now on."""
        self.buffers[os.path.normpath(path)] = text
        self._analyses.clear()

    def close(self, path: Path) -> None:
        """Take the file from the disk again."""
        self.buffers.pop(os.path.normpath(path), None)
        self._analyses.clear()

    def _read(self, path: Path) -> str:
        buffer = self.buffers.get(os.path.normpath(path))
        return self._read_disk(path) if buffer is None else buffer

    def analysis(self, path: Path) -> Analysis:
        """The system that a file belongs to."""
        key = os.path.normpath(path)
        if key not in self._analyses:
            self._analyses[key] = self._analyse(path)
        return self._analyses[key]

    def _analyse(self, path: Path) -> Analysis:
        own = load(path, read=self._read, messages=self._messages())
        if any(diagnostic.code == "E106" for diagnostic in own.diagnostics):
            for root in self._candidates(path):
                found = Analysis(root, load(root, read=self._read, messages=self._messages()), None)
                if found.source(path) is not None:
                    found.index = None if found.loaded.resolved is None else Index(found.loaded.resolved)
                    return found
        return Analysis(path, own, None if own.resolved is None else Index(own.resolved))

    def _candidates(self, path: Path) -> Iterable[Path]:
        """Files that may be the system that includes ``path``: open ones first."""
        folders = [path.parent, path.parent.parent, *self.roots]
        listed: dict[str, None] = dict.fromkeys(self.buffers)
        for folder in folders:
            try:
                names = sorted(os.listdir(folder))[:_SEARCHED]
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

    # -- answers -----------------------------------------------------------------------------------------

    def diagnostics(self, path: Path) -> dict[Path, list[Diagnostic]]:
        """The diagnostics of the system that ``path`` belongs to, by file; a file without any has an empty list."""
        analysis = self.analysis(path)
        found: dict[Path, list[Diagnostic]] = {
            configuration.path: [] for configuration in analysis.loaded.files if configuration.path is not None
        }
        found.setdefault(path, [])
        for diagnostic in analysis.loaded.diagnostics:
            source = None if diagnostic.span is None else diagnostic.span.source
            place = analysis.root if source is None or source.path is None else source.path
            found.setdefault(place, []).append(diagnostic)
        return found

    def _at(self, path: Path, line: int, column: int) -> tuple[Analysis, Occurrence | None]:
        analysis = self.analysis(path)
        source = analysis.source(path)
        if source is None or analysis.index is None:
            return analysis, None
        return analysis, analysis.index.at(source, source.offset(line, column))

    def hover(self, path: Path, line: int, column: int) -> str | None:
        """What is named at a place (both counted from 1), as Markdown: its contract, its current best mode."""
        analysis, found = self._at(path, line, column)
        if found is None or analysis.loaded.resolved is None:
            return None
        specification = analysis.loaded.specification
        if found.symbol.kind == "contract":
            contract = analysis.loaded.resolved.contracts.named(found.symbol.name)
            return f"**contract** `{found.symbol.name}`\n\n`{contract}`" if contract is not None else None
        return hover(found.symbol, analysis.loaded.resolved.specification, runnable=specification is not None)

    def definition(self, path: Path, line: int, column: int) -> Span | None:
        """Where what is named at a place is declared."""
        analysis, found = self._at(path, line, column)
        declared = None if found is None or analysis.index is None else analysis.index.declaration(found.symbol)
        return None if declared is None else declared.span

    def references(self, path: Path, line: int, column: int) -> list[Span]:
        """Every place where what is named there is named."""
        analysis, found = self._at(path, line, column)
        if found is None or analysis.index is None:
            return []
        return [occurrence.span for occurrence in analysis.index.all_of(found.symbol)]

    def rename(self, path: Path, line: int, column: int, name: str) -> list[tuple[Span, str]]:
        """The edits that give what is named at a place another name. Raises ValueError for what can be no name of
        it, and where the system would be in error with it."""
        analysis, found = self._at(path, line, column)
        if found is None or analysis.index is None or analysis.index.declaration(found.symbol) is None:
            raise ValueError("nothing that has a name of its own is named here")
        if not is_topic_name(name) or (("/" in name or name.startswith("~")) and found.symbol.kind != "topic"):
            raise ValueError(f"`{name}` cannot name a {found.symbol.kind}")
        edits: dict[tuple[str, int], tuple[Span, str]] = {}
        for symbol, occurrence in analysis.index.together(found.symbol):
            namespace = found.namespace if symbol == found.symbol else occurrence.namespace
            for place in analysis.index.all_of(symbol):
                text = _renamed(place, name, "/" + join(namespace, name))
                edits[place.span.source.name, place.span.start] = place.span, text
        self._must_not_break(analysis, list(edits.values()))
        return list(edits.values())

    def _must_not_break(self, analysis: Analysis, edits: list[tuple[Span, str]]) -> None:
        """Raises ValueError where there would be an error that there was not: a name that is taken, for one."""
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
                raise ValueError(f"it would be an error: {diagnostic.message}")

    def complete(self, path: Path, line: int, column: int) -> list[Completion]:
        """What may be written at a place."""
        analysis = self.analysis(path)
        source = analysis.source(path)
        if source is None or analysis.loaded.resolved is None:
            return []
        return complete(source, source.offset(line, column), analysis.loaded.resolved)

    def format(self, path: Path) -> str | None:
        """The canonical text of a file; None where it has errors that prevent it."""
        try:
            return format_text(self._read(path), str(path)).text
        except (Unreadable, OSError):
            return None


def _renamed(occurrence: Occurrence, name: str, full: str) -> str:
    """What is to be written at a place for a symbol that is called ``name`` now; ``full`` is a topic's whole name."""
    text = occurrence.span.text
    if occurrence.symbol.kind == "node":
        return f"{text[: text.rfind('/') + 1]}{name}"
    return _topic_from(occurrence, full) if occurrence.symbol.kind == "topic" else name


def _topic_from(occurrence: Occurrence, full: str) -> str:
    """A topic's full name as it is written in a namespace where it was written relatively before."""
    prefix = f"/{occurrence.namespace}/" if occurrence.namespace else "/"
    if occurrence.span.text.startswith("/") or not full.startswith(prefix):
        return full
    return full.removeprefix(prefix)
