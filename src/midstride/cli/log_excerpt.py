"""Excerpts of a component's log: how a change looks from a subscriber's side."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

# ROS's format: [INFO] [1795230947.628793895] [listener]: I heard: …; the simulator's has no time.
_LINE = re.compile(r"\[(?P<level>[A-Z]+)\] (?:\[(?P<at>\d+\.\d+)\] )?\[[^\]]*\]: (?P<text>.*)")
# Lines shown before and after each change.
CONTEXT = 2


@dataclass(frozen=True, slots=True)
class LogLine:
    at: float | None
    text: str

    def __str__(self) -> str:
        if self.at is None:
            return self.text
        whole, millis = divmod(round(self.at * 1000), 1000)
        return f"{time.strftime('%H:%M:%S', time.localtime(whole))}.{millis:03d}  {self.text}"

    @property
    def kind(self) -> str:
        """The text without its numbers: lines that differ in nothing else are of one kind."""
        return re.sub(r"\d+", "#", self.text)


class LogSource(Protocol):
    def read(self) -> str: ...


class LogFile:
    """The log file of a process."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> str:
        try:
            return self._path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""


class LogFollower:
    """Reads a log piece by piece."""

    def __init__(self, log: LogSource) -> None:
        self._log = log
        self._seen = 0

    def new_lines(self) -> list[LogLine]:
        """The lines since the last call."""
        lines = self._log.read().splitlines()
        fresh, self._seen = lines[self._seen :], len(lines)
        return [parsed for line in fresh if (parsed := parse(line)) is not None]


def parse(line: str) -> LogLine | None:
    """A line of a log; None for one that no logger wrote."""
    found = _LINE.match(line)
    if found is None:
        return None
    return LogLine(float(found["at"]) if found["at"] else None, found["text"])


def excerpt(lines: list[LogLine]) -> list[LogLine | None]:
    """The lines around each change of kind, with None for those left out between them."""
    shown: set[int] = set()
    for index in range(1, len(lines)):
        if lines[index].kind != lines[index - 1].kind:
            shown.update(range(max(0, index - CONTEXT), min(len(lines), index + CONTEXT)))
    result: list[LogLine | None] = []
    last = -1
    for index in sorted(shown):
        if result and index != last + 1:
            result.append(None)
        result.append(lines[index])
        last = index
    return result
