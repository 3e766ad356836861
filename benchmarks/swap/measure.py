"""Measures one cell: its swaps, under its load, into a file of raw rows."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .cells import Cell, Condition
from .judging import WINDOW_PERIODS, Figures, Row, judged
from .streams import Host, Recording, Stream, SwapFailed, recording
from .ways import Setting, Swap, Way

# How long the stream runs before the first swap (s): until everybody has found everybody.
SETTLE = 2.0


@dataclass(frozen=True)
class Window:
    """When a swap began and ended (steady ns), and why nothing was replaced, if that is so."""

    begun: int
    ended: int
    taken_back: str | None = None


@dataclass(frozen=True)
class Measured:
    """A cell that has been measured. ``about``: the machine, versions, load and whatever else its file says first."""

    cell: Cell
    about: Mapping[str, Any]
    windows: tuple[Window, ...]
    rows: tuple[Row, ...]

    def figures(self) -> list[Figures]:
        """The figures of each swap."""
        period = self.cell.condition.stream.period
        return [judged(self.rows, each.begun, each.ended, period) for each in self.windows]

    def write(self, path: Path) -> None:
        """Write a line for the cell, for each window, and for each row in a window; the file is whole or not there."""
        before = round(WINDOW_PERIODS * self.cell.condition.stream.period * 1e9)
        lines: list[Any] = [{"cell": asdict(self.cell), **self.about}, *map(asdict, self.windows)]
        lines += [
            row for row in self.rows if any(each.begun - before <= row.received <= each.ended for each in self.windows)
        ]
        part = path.with_suffix(".part")
        part.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
        part.replace(path)

    @staticmethod
    def read(path: Path) -> Measured:
        """What a file says. Raises ValueError if it is not such a file."""
        windows, rows = [], []
        with path.open(encoding="utf-8") as file:
            about = json.loads(file.readline())
            for line in file:
                found = json.loads(line)
                if isinstance(found, dict):
                    windows.append(Window(**found))
                else:
                    rows.append(Row(*found))
        told = about.pop("cell")
        condition = told["condition"]
        cell = Cell(told["way"], Condition(Stream(**condition["stream"]), condition["load"]))
        return Measured(cell, about, tuple(windows), tuple(rows))


@contextmanager
def _alone(recorded: Recording, way: Way) -> Iterator[None]:
    """Raises SwapFailed if anything is heard before the way begins."""
    if not way.records:
        time.sleep(SETTLE)
        if recorded.follow():
            raise SwapFailed("another program publishes on /swap; let ROS_DOMAIN_ID be a domain without it")
    yield


@contextmanager
def load(kind: str) -> Iterator[int]:
    """While inside, so many processes do nothing but compute: one per processor where ``kind`` is `busy`, else none."""
    count = (os.cpu_count() or 1) if kind == "busy" else 0
    busy = [subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield count
    finally:
        for each in busy:
            each.kill()
            each.wait()


def _processor_times() -> tuple[float, float]:
    """The time that processors were idle, and all of it, since the machine started (s)."""
    import psutil

    times = psutil.cpu_times()
    return times.idle + times.iowait, sum(times[:8])


def measure(cell: Cell, way: Way, host: Host, swaps: int, dora: Path | None = None) -> Measured:
    """Swap so many times under the condition of the cell. Raises SwapFailed."""
    stream = cell.condition.stream
    with tempfile.TemporaryDirectory(prefix="swap") as name:
        folder = Path(name) / "way"
        folder.mkdir()
        setting = Setting(host, stream, folder, Path(name) / "rows.jsonl", dora)
        windows: list[Window] = []
        own = nullcontext(Recording(setting.rows)) if way.records else recording(host, stream, setting.rows)
        with own as recorded, _alone(recorded, way), way.running(setting) as swap:
            recorded.until(len, "nothing is heard of the publisher")
            time.sleep(SETTLE)
            with load(cell.condition.load) as busy:
                time.sleep(SETTLE if busy else 0.0)
                before, idle = os.getloadavg(), _processor_times()
                for _ in range(swaps):
                    windows.append(_one(recorded, stream, swap, way.swaps))
                after, idle_after = os.getloadavg(), _processor_times()
            recorded.follow()
        about = {
            "backend": host.backend,
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "busy_processes": busy,
            "load_average": [before[0], after[0]],
            "idle_share": (idle_after[0] - idle[0]) / max(1e-9, idle_after[1] - idle[1]),
        }
        return Measured(cell, about, tuple(windows), tuple(recorded.rows))


def _one(recorded: Recording, stream: Stream, swap: Swap, replaces: bool) -> Window:
    time.sleep(stream.tail)
    talker = recorded.follow()[-1].talker
    begun = time.monotonic_ns()
    taken_back = swap()
    if replaces and taken_back is None:
        recorded.until(lambda rows: rows[-1].talker != talker, "nothing is heard of the new publisher")
    time.sleep(stream.tail)
    return Window(begun, time.monotonic_ns(), taken_back)
