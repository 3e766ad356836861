"""Reading a file and all it includes, within bounds.

Files are read through a ``read`` that may be anything (an editor's buffers, say). Whatever is on the
disk, this ends: cycles are errors, and how much is read in all is limited.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.parser import parse
from midstride.lang.source import Source, Span
from midstride.lang.syntax import File, IncludeStatement, Item, NamespaceBlock
from midstride.model.near_miss import did_you_mean

Read = Callable[[Path], str]

MAX_FILE: Final = 4 * 2**20  # characters of one file
MAX_TOTAL: Final = 16 * 2**20  # characters of all files
MAX_FILES: Final = 256  # files that are read
MAX_PLACES: Final = 1024  # files times namespaces they are included in
MAX_DEPTH: Final = 32  # includes of includes
_MOST_NEARBY: Final = 1000  # files that a misspelt name is compared with


class Unreadable(Exception):
    """A file cannot be read as text. ``str`` of it says why."""

    def __init__(self, code: str, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.help = help


@dataclass(frozen=True, slots=True)
class Placed:
    """The syntax of a file, and the namespace that its relative names are in (``""``: none)."""

    file: File
    namespace: str


def read_text(path: Path) -> str:
    """The text of a regular file in UTF-8, of bounded size. Raises Unreadable or OSError."""
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise Unreadable("E100", "it is no regular file")
    with open(path, "rb") as stream:
        data = stream.read(MAX_FILE + 1)
    if len(data) > MAX_FILE:
        raise Unreadable("E102", f"it is larger than {MAX_FILE // 2**20} MiB", "is this the file you meant?")
    return decoded(data)


def decoded(data: bytes) -> str:
    """``data`` as UTF-8, a byte order mark left out. Raises Unreadable with the place of the first byte that is
    none."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        line = before.count(b"\n") + 1
        column = len(before[before.rfind(b"\n") + 1 :].decode("utf-8-sig", "replace")) + 1
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise Unreadable("E101", "it is in UTF-16, not in UTF-8", "save it as UTF-8") from None
        message = f"it is not in UTF-8: byte 0x{data[error.start]:02x} at line {line}, column {column}"
        raise Unreadable("E101", message, "save it as UTF-8") from None


def read_source(path: Path, read: Read, name: str | None = None) -> Source:
    """The source of a file. Raises Unreadable."""
    try:
        text = read(path)
    except Unreadable:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise Unreadable("E100", reason[:1].lower() + reason[1:]) from None
    if len(text) > MAX_FILE:
        raise Unreadable("E102", f"it is larger than {MAX_FILE // 2**20} MiB", "is this the file you meant?")
    return Source(name or str(path), text, path)


class Loader:
    """Reads files with what they include. ``placed`` holds each file once for each namespace it is included in."""

    def __init__(self, read: Read, reporter: Reporter) -> None:
        self.read = read
        self.reporter = reporter
        self.placed: list[Placed] = []
        self.sources: list[Source] = []
        self.lost: set[str] = set()
        self.incomplete = False  # whether a file could not be read, so that anything may be declared in it
        self._files: dict[str, File | None] = {}
        self._done: set[tuple[str, str]] = set()
        self._stack: list[str] = []
        self._total = 0

    def load(self, source: Source) -> None:
        """Take ``source`` as the outermost file, and all it includes."""
        file = self._parsed(source)
        key = os.path.normpath(source.path) if source.path is not None else source.name
        self._files[key] = file
        self._place(key, file, "")

    def _parsed(self, source: Source) -> File:
        self.sources.append(source)
        self._total += len(source.text)
        file = parse(source, self.reporter)
        self.lost |= file.lost
        return file

    def _place(self, key: str, file: File, namespace: str) -> None:
        self._done.add((key, namespace))
        self._stack.append(key)
        self.placed.append(Placed(file, namespace))
        self._includes(file.items, Path(key).parent, namespace)
        self._stack.pop()

    def _includes(self, items: tuple[Item, ...], folder: Path, namespace: str) -> None:
        for item in items:
            if isinstance(item, NamespaceBlock):
                self._includes(item.items, folder, join(namespace, item.name.text))
            elif isinstance(item, IncludeStatement):
                self._include(item, folder, namespace)

    def _include(self, statement: IncludeStatement, folder: Path, namespace: str) -> None:
        span, text = statement.path.span, statement.path.text
        if not text or "\0" in text:
            self.incomplete = True
            self.reporter.report("E100", span, "this names no file")
            return
        key = os.path.normpath(folder / text)
        if key in self._stack:
            circle = [*self._stack[self._stack.index(key) :], key]
            told = " includes ".join(os.path.basename(name) for name in circle)
            self.reporter.report("E103", span, f"files include each other: {told}", help="take one of the includes out")
            return
        if (key, namespace) in self._done:
            return
        bound = self._bound()
        if bound:
            self.incomplete = True
            self.reporter.report(
                "E104", span, f"too much is included: {bound}", help="is a file included by what it includes?"
            )
            return
        file = self._files[key] if key in self._files else self._read(key, text, span)
        self._files[key] = file
        if file is None:
            self.incomplete = True
            return
        if file.system is not None:
            message = f"`{text}` is a system of its own, and only a fragment can be included"
            note = Note("its system is named here", file.system.span)
            self.reporter.report("E105", span, message, help="take the `system` line out of it", notes=[note])
        self._place(key, file, namespace)

    def _bound(self) -> str | None:
        if len(self._stack) > MAX_DEPTH:
            return f"more than {MAX_DEPTH} files, each included by the one before"
        if len(self._files) >= MAX_FILES:
            return f"more than {MAX_FILES} files"
        if len(self.placed) >= MAX_PLACES:
            return f"more than {MAX_PLACES} times a file"
        if self._total > MAX_TOTAL:
            return f"more than {MAX_TOTAL // 2**20} MiB"
        return None

    def _read(self, key: str, text: str, span: Span) -> File | None:
        shown = key
        parent = span.source.name
        if not os.path.isabs(text):
            shown = os.path.normpath(os.path.join(os.path.dirname(parent), text))
        try:
            return self._parsed(read_source(Path(key), self.read, shown))
        except Unreadable as error:
            help = error.help or _nearby(key, shown)
            self.reporter.report(error.code, span, f"`{text}` cannot be included: {error}", help=help)
            return None


def _nearby(path: str, shown: str) -> str | None:
    """What else may have been meant by a file that is not there; where it has been looked for, if nothing."""
    if os.path.exists(path):
        return None
    folder, name = os.path.split(path)
    try:
        with os.scandir(folder or ".") as entries:
            files = [entry.name for entry in islice(entries, _MOST_NEARBY) if entry.name.endswith(".stride")]
    except (OSError, ValueError):
        files = []
    near = did_you_mean(name, files)
    return near or f"it is looked for beside this file, as `{shown}`"


def join(namespace: str, name: str) -> str:
    """``name`` in ``namespace``, as ROS resolves it: one that begins with a slash is in none."""
    if name.startswith("/"):
        return name.strip("/")
    return f"{namespace}/{name}" if namespace else name
