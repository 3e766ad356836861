"""The logs of components: their ends, for whoever asks why one has ended, and their length.

A component writes to its log by itself, at the end of the file, for as long as it runs. The logs lie beside the state,
often in memory (``XDG_RUNTIME_DIR``): after some days they would fill it, and a component that cannot write any more
fails at its next word.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

_TAIL: Final = 4000


def tail(log: Path | None, length: int = _TAIL, since: int = 0) -> str:
    """The end of a log from the byte ``since`` on, in whole lines."""
    if log is None:
        return ""
    try:
        with open(log, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(since, size - length))
            text = file.read().decode(errors="replace")
    except OSError:
        return ""
    return text if size - since <= length else text.partition("\n")[2]


def shorten(log: Path, longest: int, kept: int) -> bool:
    """Cut a log that is longer than ``longest`` to its last ``kept`` bytes, in whole lines; whether that was done.

    Whoever writes goes on at the new end, since it appends. What it writes in this very moment may be lost.
    """
    try:
        size = log.stat().st_size
        if size <= longest:
            return False
        with open(log, "r+b") as file:
            file.seek(max(0, size - kept))
            end = file.read().partition(b"\n")[2]
            file.truncate(0)
        with open(log, "ab") as file:
            file.write(end)
    except OSError:
        return False
    return True
