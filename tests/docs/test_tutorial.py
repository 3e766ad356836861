"""Follows the tutorial: its files, its edits, its commands, and their output.

The word after the fence decides what happens to a block: one with ``file=…`` is written to that file; a ``diff`` is
applied to it, at the last place that fits; ``console`` lines that begin with ``$`` are run, and must print the lines
that follow, where ``…`` matches anything. What only queries the system is run again for some seconds if it prints
something else.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial.md"
QUERY = re.compile(r"midstride (status|why|logs)\b")
_BLOCK = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    kind: str
    options: dict[str, str]
    text: str


def blocks() -> Iterator[Block]:
    for match in _BLOCK.finditer(TUTORIAL.read_text(encoding="utf-8")):
        options = {word.partition("=")[0]: word.partition("=")[2] for word in match[2].split()}
        yield Block(match[1], options, match[3])


def edited(text: str, diff: str) -> str:
    """``text`` after ``diff``, whose lines begin with a blank, ``-`` or ``+``."""
    lines = diff.splitlines(keepends=True)
    assert {line[0] for line in lines} <= set(" -+"), diff
    old, new = ("".join(line[1:] for line in lines if line[0] != sign) for sign in "+-")
    before, found, after = text.rpartition(old)
    assert found, f"the tutorial edits what is not there: {diff}"
    return before + new + after


def answers(expected: list[str], out: str) -> bool:
    """Whether the output is as expected. A line ``…`` matches any lines, ``…`` within a line any words."""
    pattern = ""
    for line in expected:
        if line.strip() == "…":
            pattern += r"(?:.*\n)*?"
        else:
            words = [re.escape(part) for part in re.split(r"\s*…\s*", line)]
            pattern += r"\s*" + ".*".join(words) + r"\s*?\n"
    return re.fullmatch(pattern, out if out.endswith("\n") or not out else out + "\n") is not None


class Terminal:
    """A command that keeps running while the tutorial goes on, and what it has printed."""

    def __init__(self, command: str, folder: Path, environment: dict[str, str]) -> None:
        self.file = folder / ".terminal"
        self.read = 0
        with self.file.open("wb") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", *shlex.split(command)],
                cwd=folder,
                env={**environment, "PYTHONUNBUFFERED": "1"},
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
            )

    def expect(self, lines: list[str]) -> None:
        """Wait until these lines have been printed, after those that were expected before."""
        end = time.monotonic() + 60
        while not answers(lines, (printed := self.file.read_text(encoding="utf-8")[self.read :])):
            assert self.process.poll() is None and time.monotonic() < end, f"{printed}\n-- instead of --\n{lines}"
            time.sleep(0.1)
        self.read += len(printed)

    def interrupt(self) -> None:
        """Press Ctrl-C, and wait for the end."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(30)
        finally:
            self.process.kill()


def play(folder: Path, backend: str) -> None:
    """Follow the tutorial in ``folder`` on ``backend``, and compare the output of each command."""
    runtime = tempfile.mkdtemp(prefix="ms")  # sockets have short paths
    environment = {**os.environ, "XDG_RUNTIME_DIR": runtime, "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"}

    def run(command: str) -> subprocess.CompletedProcess[str]:
        words = shlex.split(command)
        return subprocess.run(
            [sys.executable, "-m", *words] if words[0] == "midstride" else words,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=100,
            check=False,
        )

    commands = 0
    terminals: dict[str, Terminal] = {}
    try:
        for block in blocks():
            if block.kind == "diff":
                path = folder / block.options["file"]
                path.write_text(edited(path.read_text(encoding="utf-8"), block.text), encoding="utf-8")
            elif "file" in block.options:
                (folder / block.options["file"]).write_text(block.text, encoding="utf-8")
            elif "terminal" in block.options:
                name, text = block.options["terminal"], block.text
                if text.startswith("$ "):
                    command, _, text = text[2:].partition("\n")
                    terminals[name] = Terminal(command, folder, environment)
                    commands += 1
                terminals[name].expect(text.splitlines())
            else:
                assert block.kind == "console", block.kind
                text = block.text.replace("--backend sim", f"--backend {backend}").replace("on sim", f"on {backend}")
                for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                    command, *expected = part.rstrip("\n").split("\n")
                    end = time.monotonic() + (20 if QUERY.match(command) else 0)
                    while not answers(expected, (done := run(command)).stdout) and time.monotonic() < end:
                        time.sleep(0.1)
                    assert done.returncode == int(block.options.get("status", "0")), (command, done)
                    printed = f"$ {command}\n{done.stdout}\n-- instead of --\n" + "\n".join(expected)
                    assert answers(expected, done.stdout), printed
                    commands += 1
        assert run("midstride status").returncode == 1, "the last chapter ends it"
    finally:
        for terminal in terminals.values():
            terminal.interrupt()
        run("midstride down")
        shutil.rmtree(runtime)
    assert commands >= 12


@pytest.mark.full
@pytest.mark.parametrize(
    "backend", [pytest.param("sim", marks=pytest.mark.long), pytest.param("ros2", marks=pytest.mark.ros2)]
)
def test_the_tutorial_can_be_done(tmp_path: Path, backend: str) -> None:
    play(tmp_path, backend)


def test_every_command_of_the_tutorial_is_midstrides() -> None:
    """But for those that make and remove the file that breaks the sensor."""
    consoles = [block.text for block in blocks() if block.kind == "console"]
    commands = [line for text in consoles for line in text.split("\n") if line[:1] == "$"]
    others = [command for command in commands if not command.startswith("$ midstride ")]
    assert others == ["$ touch unplugged", "$ rm unplugged"]


def test_the_files_of_the_tutorial_are_canonical() -> None:
    from midstride.lang import format_text

    for block in blocks():
        if block.kind == "stride":
            assert format_text(block.text).text == block.text


def test_the_tutorial_takes_a_quarter_of_an_hour() -> None:
    """Assuming 200 words a minute to read and 120 characters a minute to type; the rest is copied."""
    text = TUTORIAL.read_text(encoding="utf-8")
    typed = sum(
        len(line) for block in blocks() if block.kind == "console" for line in block.text.split("\n") if line[:1] == "$"
    )
    assert len(text.split()) / 200 + typed / 120 < 15
