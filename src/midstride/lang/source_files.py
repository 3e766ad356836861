"""Reading a file and everything it includes.

Files are read through a :data:`FileReader`, so an editor can supply its buffers. Reading always terminates: include
cycles are errors, and the amount of text is limited.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final

from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.parser import parse
from midstride.lang.source import Source
from midstride.lang.syntax import File, IncludeStatement, Item, Name, NamespaceBlock
from midstride.model.near_miss import did_you_mean
from midstride.package_files import NotFound, is_name, other_file, owner, path_of

FileReader = Callable[[Path], str]

# The environment variable with further folders that specifications may read files from, separated as in PATH.
INCLUDE_PATH: Final = "MIDSTRIDE_INCLUDE_PATH"
MAX_FILE: Final = 4 * 2**20  # characters in one file
MAX_TOTAL: Final = 16 * 2**20  # characters in all files
MAX_FILES: Final = 256  # distinct files
MAX_INCLUSIONS: Final = 1024  # files, counted once per namespace they are included in
MAX_DEPTH: Final = 32  # nesting of includes
_MAX_COMPARED: Final = 1000  # files compared with a misspelt name


class Unreadable(Exception):
    """A file cannot be read as text; ``str(error)`` gives the reason."""

    def __init__(self, code: str, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.help = help


@dataclass(frozen=True, slots=True)
class NamespacedFile:
    """The syntax of a file, and the namespace of its relative names (``""``: none).

    ``host``: where its nodes run unless they state another one.
    """

    file: File
    namespace: str
    host: Name | None = None


def read_text(path: Path) -> str:
    """The text of a regular UTF-8 file of limited size. Raises Unreadable or OSError."""
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise Unreadable("E100", "it is not a regular file")
    with open(path, "rb") as stream:
        data = stream.read(MAX_FILE + 1)
    if len(data) > MAX_FILE:
        raise Unreadable("E102", f"it is larger than {MAX_FILE // 2**20} MiB", "check that this is the intended file")
    return decode_utf8(data)


def decode_utf8(data: bytes) -> str:
    """``data`` as UTF-8, without its byte order mark. Raises Unreadable with the position of the first invalid
    byte."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        line = before.count(b"\n") + 1
        column = len(before[before.rfind(b"\n") + 1 :].decode("utf-8-sig", "replace")) + 1
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise Unreadable("E101", "it is encoded in UTF-16, not UTF-8", "save it as UTF-8") from None
        message = f"it is not valid UTF-8: byte 0x{data[error.start]:02x} at line {line}, column {column}"
        raise Unreadable("E101", message, "save it as UTF-8") from None


def read_source(path: Path, read: FileReader, name: str | None = None) -> Source:
    """The source of a file. Raises Unreadable."""
    try:
        text = read(path)
    except Unreadable:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise Unreadable("E100", reason[:1].lower() + reason[1:]) from None
    if len(text) > MAX_FILE:
        raise Unreadable("E102", f"it is larger than {MAX_FILE // 2**20} MiB", "check that this is the intended file")
    return Source(name or str(path), text, path)


def include_folders() -> list[str]:
    """The folders of `--include-path` and of the environment."""
    return [folder for folder in os.environ.get(INCLUDE_PATH, "").split(os.pathsep) if folder]


@dataclass(frozen=True, slots=True)
class Bounds:
    """The files that a specification may read: those below ``folders``, which are real paths, and those of packages.

    Diagnostics quote what they are about, so somebody else's specification must not choose freely what is read.
    """

    folders: tuple[str, ...]

    @classmethod
    def of(cls, root: Path, more: Iterable[str] = ()) -> Bounds:
        """Below the folder of the root file, below the folders that INCLUDE_PATH lists, and below ``more``."""
        # The root file may be a link, as others beside it: `colcon build --symlink-install` installs links.
        folders = (str(root.parent), os.path.dirname(os.path.realpath(root)), *include_folders(), *more)
        return cls(tuple(dict.fromkeys(os.path.realpath(folder) for folder in folders)))

    def contain(self, path: str) -> bool:
        """Return whether the file at ``path`` may be read."""
        real = os.path.realpath(path)
        if any(os.path.commonpath((folder, real)) == folder for folder in self.folders):
            return True
        return owner(path, os.environ) is not None  # installed by the user, who has sourced the workspace

    def path(self, name: Name, *endings: str) -> str:
        """The path of a file: of a package, or relative to the file that names it. Raises Unreadable if it may not be
        read, or if there is no such package."""
        if not name.text or "\0" in name.text:
            raise Unreadable("E100", "this is not a file name")
        if not name.text.endswith(endings):
            raise Unreadable("E107", f"its name does not end in {' or '.join(endings)}")
        if is_name(name.text):
            try:
                return path_of(name.text, os.environ)
            except NotFound as error:
                raise Unreadable("E108", error.message, error.help) from None
        base = name.span.source.path
        path = os.path.normpath((Path() if base is None else base.parent) / name.text)
        if not self.contain(path):
            named = f"`midstride --include-path DIR …`, or the variable {INCLUDE_PATH}"
            help = f"move it there, or name its folder: {named}"
            raise Unreadable("E107", "it is not below the folder of the file that names the system", help)
        return path


def shown_path(name: Name) -> str:
    """The path of ``name``, relative to where the file that names it is shown to be; that of a file of a package."""
    if is_name(name.text):
        with suppress(NotFound):
            return path_of(name.text, os.environ)
    return os.path.normpath(os.path.join(os.path.dirname(name.span.source.name), name.text))


@dataclass(slots=True)
class Loader:
    """Reads files and their includes.

    ``files_in_order`` holds each file once per namespace that it is included in, and per host.
    """

    read: FileReader
    reporter: Reporter
    bounds: Bounds
    files_in_order: list[NamespacedFile] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)
    skipped: set[str] = field(default_factory=set)
    files_missing: bool = False  # whether a file could not be read: any name may be declared in it
    _files: dict[str, File | None] = field(default_factory=dict)
    _done: set[tuple[str, str, str]] = field(default_factory=set)
    _stack: list[str] = field(default_factory=list)
    _total: int = 0

    def load(self, source: Source) -> None:
        """Parse ``source`` and everything it includes."""
        file = self._parsed(source)
        key = os.path.realpath(source.path) if source.path is not None else source.name
        self._files[key] = file
        self._place(key, file, "")

    def _parsed(self, source: Source) -> File:
        self.sources.append(source)
        self._total += len(source.text)
        file = parse(source, self.reporter)
        self.skipped |= file.skipped
        return file

    def _place(self, key: str, file: File, namespace: str, host: Name | None = None) -> None:
        self._done.add((key, namespace, "" if host is None else host.text))
        self._stack.append(key)
        self.files_in_order.append(NamespacedFile(file, namespace, host))
        self._follow_includes(file.items, namespace, host)
        self._stack.pop()

    def _follow_includes(self, items: tuple[Item, ...], namespace: str, host: Name | None) -> None:
        for item in items:
            if isinstance(item, NamespaceBlock):
                self._follow_includes(item.items, resolve_name(namespace, item.name.text), item.host or host)
            elif isinstance(item, IncludeStatement):
                self._include(item.path, namespace, item.host or host)

    def _include(self, name: Name, namespace: str, host: Name | None) -> None:
        text, span = name
        try:
            path = self.bounds.path(name, ".stride")
        except Unreadable as error:
            self.files_missing = True
            message = f"`{text}` cannot be included: {error}" if text else str(error)
            self.reporter.report(error.code, span, message, help=error.help)
            return
        key = os.path.realpath(path)  # a file of a package may be named in two ways
        if key in self._stack:
            cycle = [*self._stack[self._stack.index(key) :], key]
            chain = " includes ".join(os.path.basename(name) for name in cycle)
            self.reporter.report("E103", span, f"include cycle: {chain}", help="remove one of the includes")
            return
        if (key, namespace, "" if host is None else host.text) in self._done:
            return
        if bound := self._exceeded_limit():
            self.files_missing = True
            help = "check whether a file includes itself indirectly"
            self.reporter.report("E104", span, f"include limit exceeded: {bound}", help=help)
            return
        if key not in self._files:
            self._files[key] = self._read(path, name)
        file = self._files[key]
        if file is None:
            self.files_missing = True
            return
        if file.system is not None:
            message = f"`{text}` is a complete system; only a fragment can be included"
            note = Note("system named here", file.system.span)
            self.reporter.report("E105", span, message, help="remove its `system` line", notes=[note])
        self._place(key, file, namespace, host)

    def _exceeded_limit(self) -> str | None:
        if len(self._stack) > MAX_DEPTH:
            return f"includes are nested more than {MAX_DEPTH} deep"
        if len(self._files) >= MAX_FILES:
            return f"more than {MAX_FILES} files"
        if len(self.files_in_order) >= MAX_INCLUSIONS:
            return f"more than {MAX_INCLUSIONS} inclusions"
        if self._total > MAX_TOTAL:
            return f"more than {MAX_TOTAL // 2**20} MiB"
        return None

    def _read(self, path: str, name: Name) -> File | None:
        shown = shown_path(name)
        try:
            return self._parsed(read_source(Path(path), self.read, shown))
        except Unreadable as error:
            help = error.help or hint_for_missing(path, name)
            self.reporter.report(error.code, name.span, f"`{name.text}` cannot be included: {error}", help=help)
            return None


def hint_for_missing(path: str, file: Name) -> str | None:
    """A similar file name for one that does not exist, else where it was searched for."""
    if os.path.exists(path):
        return None
    if is_name(file.text) and (owned := owner(path, os.environ)) is not None:
        return f"in {owned[1]}: {other_file(owned[1], os.path.relpath(path, owned[1]))}"
    folder, name = os.path.split(path)
    endings = (".stride",) if name.endswith(".stride") else (".yaml", ".yml")
    try:
        with os.scandir(folder or ".") as entries:
            files = [entry.name for entry in islice(entries, _MAX_COMPARED) if entry.name.endswith(endings)]
    except (OSError, ValueError):
        files = []
    return did_you_mean(name, files) or f"the path is relative to this file: `{shown_path(file)}`"


def resolve_name(namespace: str, name: str) -> str:
    """``name`` in ``namespace``, resolved as in ROS: a name that starts with a slash is absolute."""
    if name.startswith("/"):
        return name.strip("/")
    return f"{namespace}/{name}" if namespace else name
