"""What a component has said, from its log: the change as it looks from a subscriber's side."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

# As ROS writes it: [INFO] [1795230947.628793895] [listener]: I heard: …; the simulator's has no time.
_LINE = re.compile(r"\[(?P<level>[A-Z]+)\] (?:\[(?P<at>\d+\.\d+)\] )?\[[^\]]*\]: (?P<words>.*)")
# Lines shown before and after each change of what is said.
AROUND = 2


@dataclass(frozen=True, slots=True)
class LogLine:
    at: float | None
    words: str

    def __str__(self) -> str:
        if self.at is None:
            return self.words
        whole, millis = divmod(round(self.at * 1000), 1000)
        return f"{time.strftime('%H:%M:%S', time.localtime(whole))}.{millis:03d}  {self.words}"

    @property
    def kind(self) -> str:
        """What kind of thing is said: two lines that differ in their numbers alone are of one kind."""
        return re.sub(r"\d+", "#", self.words)


class LogSource(Protocol):
    def read(self) -> str: ...


class LogFile:
    """The log of a process of its own."""

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

    def new(self) -> list[LogLine]:
        """What has been said since the last time."""
        lines = self._log.read().splitlines()
        fresh, self._seen = lines[self._seen :], len(lines)
        return [said for line in fresh if (said := parse(line)) is not None]


def parse(line: str) -> LogLine | None:
    """A line of a log; None for what was not said by a logger."""
    found = _LINE.match(line)
    if found is None:
        return None
    return LogLine(float(found["at"]) if found["at"] else None, found["words"])


def excerpt(said: list[LogLine]) -> list[LogLine | None]:
    """The lines around each change of what is said; None stands for those left out."""
    shown: set[int] = set()
    for index in range(1, len(said)):
        if said[index].kind != said[index - 1].kind:
            shown.update(range(max(0, index - AROUND), min(len(said), index + AROUND)))
    lines: list[LogLine | None] = []
    last = -1
    for index in sorted(shown):
        if lines and index != last + 1:
            lines.append(None)
        lines.append(said[index])
        last = index
    return lines
