"""The logs of components: reading their ends, and limiting their length.

A component appends to its log itself for as long as it runs. The logs are in the workspace, often in memory
(``XDG_RUNTIME_DIR``): without a limit they would fill it after some days, and a component that cannot write to its log
fails.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

_TAIL: Final = 4000


def tail(log: Path | None, length: int = _TAIL, since: int = 0) -> str:
    """The last ``length`` bytes of a log, in whole lines, and nothing before the byte ``since``."""
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
    """Truncate a log longer than ``longest`` bytes to its last ``kept`` bytes, in whole lines; returns whether it did.

    The component continues at the new end, since it opened the log for appending. A line that it writes during the
    truncation may be lost.
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
