"""Follows the tutorial: its files, its edits, its commands, and their output.

The word after the fence decides what happens to a block: ``stride file=…`` is written to that file; ``edit file=…``
replaces its longest first part that the file contains by the rest of the block (``place=last``: the last occurrence);
``console`` lines that begin with ``$`` are run, and must print the lines that follow, where ``…`` matches anything.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial.md"
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


def edited(text: str, block: Block) -> str:
    """``text``, in which the longest first part of the block that occurs is replaced by the rest of the block."""
    lines = block.text.rstrip("\n").split("\n")
    for cut in range(len(lines) - 1, 0, -1):
        old, new = "\n".join(lines[:cut]), "\n".join(lines[cut:])
        if old in text:
            at = text.rindex(old) if block.options.get("place") == "last" else text.index(old)
            return text[:at] + new + text[at + len(old) :]
    raise AssertionError(f"the tutorial edits what is not there: {block.text}")


def answers(expected: list[str], out: str) -> bool:
    """Whether the output is as expected. A line ``…`` matches any lines, ``…`` within a line any words."""
    pattern = ""
    for line in expected:
        if line.strip() == "…":
            pattern += r"(?:.*\n)*?"
        else:
            words = [re.escape(part) for part in re.split(r"\s*…\s*", line)]
            pattern += r"\s*" + ".*".join(words) + r"\s*?\n"
    return re.fullmatch(pattern, out if out.endswith("\n") else out + "\n") is not None


def play(folder: Path, backend: str) -> None:
    """Follow the tutorial in ``folder`` on ``backend``, and compare the output of each command."""
    runtime = tempfile.mkdtemp(prefix="ms")  # sockets have short paths
    environment = {**os.environ, "XDG_RUNTIME_DIR": runtime, "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"}

    def midstride(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "midstride", *words],
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
    try:
        for block in blocks():
            if block.kind == "stride":
                (folder / block.options["file"]).write_text(block.text, encoding="utf-8")
            elif block.kind == "edit":
                path = folder / block.options["file"]
                path.write_text(edited(path.read_text(encoding="utf-8"), block), encoding="utf-8")
            else:
                assert block.kind == "console", block.kind
                text = block.text.replace("--backend sim", f"--backend {backend}").replace("on sim", f"on {backend}")
                for part in re.split(r"^\$ midstride ", text, flags=re.MULTILINE)[1:]:
                    command, *expected = part.rstrip("\n").split("\n")
                    done = midstride(*shlex.split(command))
                    assert done.returncode == int(block.options.get("status", "0")), (command, done)
                    told = f"$ midstride {command}\n{done.stdout}\n-- instead of --\n" + "\n".join(expected)
                    assert answers(expected, done.stdout), told
                    commands += 1
        assert midstride("status").returncode == 1, "the last chapter ends it"
    finally:
        midstride("down")
        shutil.rmtree(runtime)
    assert commands >= 12


@pytest.mark.timeout(180)
@pytest.mark.parametrize("backend", ["sim", pytest.param("ros2", marks=(pytest.mark.ros2, pytest.mark.full))])
def test_the_tutorial_can_be_done(tmp_path: Path, backend: str) -> None:
    play(tmp_path, backend)


def test_every_command_of_the_tutorial_is_midstrides() -> None:
    consoles = [block.text for block in blocks() if block.kind == "console"]
    assert all(line.startswith("$ midstride ") for text in consoles for line in text.split("\n") if line[:1] == "$")


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
