"""record.py FILE.svg [--backend NAME]: runs COMMANDS in a terminal, and writes what it shows as an animation.

`make recording` writes docs/recording.svg, which the README shows. The commands run for real, in a copy of the example,
and with their real pauses; only the typing and the pauses between commands are added. What they print is not changed:
the script fails if it contains a path or a user name of this machine.
"""

from __future__ import annotations

import argparse
import getpass
import html
import os
import pty
import select
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import pyte

ROOT: Final = Path(__file__).resolve().parent.parent
COMMANDS: Final = (
    "midstride up talker.stride --detach",
    "midstride replace talker NewTalker --yes",
    "midstride logs listener --lines 2",
    "midstride status",
    "midstride down",
)
COLUMNS, ROWS = 88, 40
TYPING, PAUSE, END = 0.06, 1.2, 4.0  # seconds: a character, after a command, after the last one
FRAME = 0.1  # s; a spinner is shown no faster
SIZE, LINE, MARGIN = 14, 19, 14  # px
ADVANCE = 8.43  # px: a character of a monospaced font of that size
COLOURS: Final = {
    "default": "#e6edf3", "black": "#6e7681", "red": "#ff7b72", "green": "#56d364", "brown": "#e3b341",
    "blue": "#79c0ff", "magenta": "#d2a8ff", "cyan": "#76e3ea", "white": "#f0f6fc",
}  # fmt: skip


@dataclass(frozen=True)
class Shown:
    """What a row of the screen shows from ``start`` to ``end`` (s)."""

    row: int
    svg: str
    start: float
    end: float


class Recorder:
    """A screen, the time that has passed on it, and what its rows have shown so far."""

    def __init__(self) -> None:
        self.screen = pyte.Screen(COLUMNS, ROWS)
        self.stream = pyte.Stream(self.screen)
        self.now = 0.0
        self.since: dict[int, tuple[str, float]] = {}
        self.shown: list[Shown] = []
        self.text = ""

    def write(self, text: str) -> None:
        self.text += text
        self.stream.feed(text)
        for row in self.screen.dirty:
            self._change(row, line_svg(self.screen.buffer[row]))
        self.screen.dirty.clear()

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def _change(self, row: int, svg: str) -> None:
        before, start = self.since.get(row, ("", self.now))
        if svg != before:
            if before and self.now > start:
                self.shown.append(Shown(row, before, start, self.now))
            self.since[row] = (svg, self.now)

    def close(self) -> list[Shown]:
        return [*self.shown, *(Shown(row, svg, start, self.now) for row, (svg, start) in self.since.items() if svg)]


def line_svg(cells: Any) -> str:
    """The characters of a row, as one `tspan` for each run of one style; nothing for an empty row."""
    row = [cells[column] for column in range(COLUMNS)]
    while row and row[-1].data == " ":
        row.pop()
    runs, column = [], 0
    for (colour, bold), group in groupby(row, key=lambda cell: (cell.fg, cell.bold)):
        text = "".join(cell.data for cell in group)
        fill = COLOURS.get(colour.removeprefix("bright"), f"#{colour}")
        style = f' fill="{fill}"' + (' font-weight="bold"' if bold else "")
        if text.strip():
            runs.append(f'<tspan x="{MARGIN + column * ADVANCE:.1f}"{style}>{html.escape(text)}</tspan>')
        column += len(text)
    return "".join(runs)


def run(recorder: Recorder, command: str, folder: Path, environment: dict[str, str]) -> None:
    recorder.write("\x1b[32m$\x1b[0m ")
    for character in command:
        recorder.wait(TYPING)
        recorder.write(character)
    recorder.wait(0.4)
    recorder.write("\r\n")
    ours, theirs = pty.openpty()
    process = subprocess.Popen(shlex.split(command), cwd=folder, env=environment, stdout=theirs, stderr=theirs)
    os.close(theirs)
    last, pending = time.monotonic(), b""
    while True:
        ready, _, _ = select.select([ours], [], [], FRAME)
        try:
            pending += os.read(ours, 65536) if ready else b""
        except OSError:  # the last process has closed the terminal
            break
        if (passed := time.monotonic() - last) >= FRAME or not ready:
            recorder.wait(passed)
            recorder.write(pending.decode(errors="replace"))
            last, pending = time.monotonic(), b""
        if process.poll() is not None and not ready:  # a detached manager may keep the terminal open
            break
    os.close(ours)
    recorder.write(pending.decode(errors="replace"))
    recorder.wait(PAUSE)
    if process.wait() != 0:
        raise SystemExit(f"record: `{command}` has failed:\n{recorder.text}")


def svg(shown: list[Shown], duration: float) -> str:
    """An animation that repeats; where motion is not wanted, its last picture."""
    styles, lines = [], []
    spans: dict[tuple[float, float], str] = {}
    for entry in shown:
        times = (entry.start, entry.end)
        if times not in spans:
            name = spans[times] = f"t{len(spans)}"
            start, end = (100 * at / duration for at in times)
            lasts = entry.end >= duration
            hidden = "" if lasts else f"{end:.2f}%{{opacity:0}}"
            styles.append(f".{name}{{animation-name:{name};opacity:{int(lasts)}}}")
            styles.append(f"@keyframes {name}{{0%{{opacity:0}}{start:.2f}%{{opacity:1}}{hidden}}}")
        y = MARGIN + SIZE + entry.row * LINE
        lines.append(f'<text class="{spans[times]}" y="{y}">{entry.svg}</text>')
    rows = 1 + max(entry.row for entry in shown)
    width, height = round(2 * MARGIN + COLUMNS * ADVANCE), 2 * MARGIN + rows * LINE
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">',
            f"<title>{html.escape('; '.join(COMMANDS))}</title>",
            "<style>",
            f"text{{font:{SIZE}px ui-monospace,'DejaVu Sans Mono',Menlo,Consolas,monospace;white-space:pre;"
            f"animation:{duration:.2f}s step-end infinite}}",
            *styles,
            "@media (prefers-reduced-motion:reduce){text{animation:none}}",
            "</style>",
            f'<rect width="{width}" height="{height}" rx="8" fill="#0d1117"/>',
            *lines,
            "</svg>\n",
        ]
    )


def record(backend: str | None) -> str:
    folder = Path(tempfile.mkdtemp(prefix="ms"))
    work = folder / "talker"
    shutil.copytree(ROOT / "examples" / "talker", work, ignore=shutil.ignore_patterns("__pycache__"))
    environment = {
        **os.environ,
        "TERM": "xterm-256color",
        "COLUMNS": str(COLUMNS),
        "LINES": str(ROWS),
        "XDG_RUNTIME_DIR": str(folder),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        **({"MIDSTRIDE_BACKEND": backend} if backend else {}),
    }
    recorder = Recorder()
    try:
        for command in COMMANDS:
            run(recorder, command, work, environment)
    finally:
        subprocess.run(["midstride", "down"], env=environment, capture_output=True, check=False)
        shutil.rmtree(folder, ignore_errors=True)
    user = getpass.getuser()
    private = {str(folder), str(ROOT), str(Path.home()), sys.prefix, socket.gethostname(), f"{user}@", f"/{user}"}
    if found := sorted(name for name in private if name in recorder.text):
        raise SystemExit(f"record: the output names {', '.join(found)}:\n{recorder.text}")
    recorder.wait(END)
    return svg(recorder.close(), recorder.now)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--backend")
    asked = parser.parse_args()
    asked.file.write_text(record(asked.backend), encoding="utf-8")
