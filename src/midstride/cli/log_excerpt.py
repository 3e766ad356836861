"""Excerpts of a component's log: how a change looks from a subscriber's side."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from midstride.cli.render import time_of_day

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
        return f"{time_of_day(self.at)}  {self.text}"

    @property
    def kind(self) -> str:
        """The text without its numbers: lines that differ in nothing else are of one kind."""
        return re.sub(r"\d+", "#", self.text)


class LogFollower:
    """Reads a log piece by piece; ``read`` returns all of it."""

    def __init__(self, read: Callable[[], str]) -> None:
        self._read = read
        self._seen = 0

    def new_lines(self) -> list[LogLine]:
        """The lines since the last call."""
        lines = self._read().splitlines()
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
    for index in sorted(shown):
        if result and index - 1 not in shown:
            result.append(None)
        result.append(lines[index])
    return result
