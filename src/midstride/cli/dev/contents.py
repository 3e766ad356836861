"""The contents of files, and waiting until one of them may have changed."""

from __future__ import annotations

import glob
import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

# A save is complete when nothing has been written for this long, or after so long at most (ms).
STEP: Final = 10
DEBOUNCE: Final = 100
# How often the files are looked at where no event comes, as on some network drives (ms).
POLL: Final = 1000
# Editors replace a file: for how long it may be missing (s).
REPLACING: Final = 0.05

# The digest of each file, None where there is no such file.
Contents: TypeAlias = Mapping[str, str | None]


class FileContents:
    """Reads files, each again only where its size or time has changed."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[tuple[int, int, int], str]] = {}

    def of(self, paths: Iterable[str]) -> Contents:
        """The contents now. A file that is missing is looked at once more: it may just be replaced."""
        wanted = sorted(set(paths))
        found = {path: self._digest(path) for path in wanted}
        if any(found[path] is None and path in self._known for path in wanted):
            time.sleep(REPLACING)
            found = {path: self._digest(path) for path in wanted}
        return found

    def _digest(self, path: str) -> str | None:
        try:
            status = os.stat(path)
            signature = (status.st_size, status.st_mtime_ns, status.st_ino)
            known = self._known.get(path)
            if known is None or known[0] != signature:
                with open(path, "rb") as file:
                    known = self._known[path] = signature, hashlib.blake2b(file.read()).hexdigest()
            return known[1]
        except OSError:
            return None


def remove_compiled(path: str) -> None:
    """Remove what Python has compiled from a module.

    Python compares whole seconds and sizes, so it would run the old code after two saves of one size in a second.
    """
    module = Path(path)
    for compiled in module.parent.glob(f"__pycache__/{glob.escape(module.stem)}.*.pyc"):
        with suppress(OSError):
            compiled.unlink()


def saves(folders: Callable[[], frozenset[str]]) -> Iterator[None]:
    """Yields whenever something may have changed in ``folders()``, which may be others each time."""
    from watchfiles import watch

    while True:
        watched = folders()
        events = watch(
            *watched,
            watch_filter=None,
            step=STEP,
            debounce=DEBOUNCE,
            rust_timeout=POLL,
            yield_on_timeout=True,
            recursive=False,
        )
        for _ in events:
            yield
            if folders() != watched:
                break
