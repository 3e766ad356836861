"""The place where each run begins in a log: processes of one name, one after the other, append to one file."""

from __future__ import annotations

import re
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

_BEGIN: Final = re.compile(r"==== (?P<instance>\S+) was started (?P<at>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d) ====")


def begin_run(log: Path, instance: str) -> None:
    """Append the line before what the next process of ``instance`` writes; without one where that is not possible."""
    with suppress(OSError), log.open("ab+") as file:  # the start of the process reports it
        if end := file.seek(0, 2):
            file.seek(end - 1)
            if file.read(1) != b"\n":
                file.write(b"\n")
        file.write(f"==== {instance} was started {time.strftime('%Y-%m-%d %H:%M:%S')} ====\n".encode())


def run_begun(line: str) -> str | None:
    """The time at which a run began (local time), for the line before it; None for any other line."""
    found = _BEGIN.fullmatch(line)
    return None if found is None else found["at"]


def text_of_latest_run(text: str) -> str:
    """The text behind the last line that begins a run, or all of ``text``."""
    lines = text.splitlines(keepends=True)
    begins = [index for index, line in enumerate(lines, 1) if run_begun(line.rstrip("\n")) is not None]
    return "".join(lines[begins[-1] if begins else 0 :])
