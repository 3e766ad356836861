"""The fingerprint of a program: its files, each as it was when the program read it (docs/protocols/programs.md).

A process has read its files some time between its start and the moment it lists them. A file that was modified in
between may have been read before or after, so its content counts as unknown: it differs from any other.
"""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Iterable, Iterator
from typing import Final

from msgspec.structs import replace

from midstride.wire.state import WireValue

# Larger files are compared by size and time of modification alone (bytes).
LARGEST_HASHED: Final = 16 * 2**20
# The digest of a file of which it is unknown what the program has read.
UNKNOWN: Final = ""
# Words of a command that are parts of the program where they name a file, besides what can be executed. Others may be
# files that the program writes.
_READ: Final = frozenset(".py .sh .bash .yaml .yml .json .toml .ini .cfg .xml .urdf".split())


class FileFingerprint(WireValue, frozen=True, kw_only=True):
    """One file. ``modified``: when it was modified last (unix ns); ``digest``: of its content, None if it is large."""

    path: str
    size: int
    modified: int
    digest: str | None

    @classmethod
    def read(cls, path: str, started: int) -> FileFingerprint | None:
        """The file as a program has read it that started at ``started`` (unix ns); None if it is no regular file."""
        try:
            found = os.stat(path)
            if not stat.S_ISREG(found.st_mode):
                return None
            since_start = started < found.st_mtime_ns <= time.time_ns()  # else the time was set, to one to come
            digest = UNKNOWN if since_start else _digest(path, found.st_size)
        except (OSError, ValueError):
            return None
        return cls(path=path, size=found.st_size, modified=found.st_mtime_ns, digest=digest)

    def unchanged(self) -> FileFingerprint | None:
        """The file as it is now; None if it has another content, or does not exist any more.

        Only its time of modification may differ. Ask the result the next time: it does not read the file again.
        """
        try:
            found = os.stat(self.path)
            if self.digest == UNKNOWN:
                return None
            if (found.st_size, found.st_mtime_ns) == (self.size, self.modified):
                return self
            if self.digest is None or found.st_size != self.size or _digest(self.path, self.size) != self.digest:
                return None
            return replace(self, modified=found.st_mtime_ns)
        except OSError:
            return None


class Program(WireValue, frozen=True, kw_only=True):
    """A running program, as far as it is known. ``started``: unix ns; ``complete``: whether all its modules are
    listed.
    """

    files: list[FileFingerprint]
    started: int
    complete: bool = True


def _digest(path: str, size: int) -> str | None:
    if size > LARGEST_HASHED:
        return None
    with open(path, "rb") as file:
        return hashlib.blake2b(file.read(LARGEST_HASHED + 1), digest_size=16).hexdigest()


def files_named(words: Iterable[str], directory: str) -> Iterator[str]:
    """The files that the words of a command name, relative to ``directory``, if they look like parts of a program."""
    for word in words:
        path = os.path.join(directory, word.rpartition("=")[2])
        if os.path.splitext(path)[1] in _READ or ("/" in word and os.access(path, os.X_OK)):
            yield os.path.normpath(path)
