"""The tutorial is done as it is written: its files, its edits, its commands, and what they answer.

Blocks are told apart by the word behind the fence: ``stride file=…`` is written to that file; ``edit file=…`` replaces
its first lines, as far as they are found in the file, by the rest (``place=last``: where they stand last);
``console`` lines that begin with ``$`` are run, and what follows must be answered, ``…`` standing for anything.
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
    """``text`` with the longest first part of the block that it holds replaced by the rest of the block."""
    lines = block.text.rstrip("\n").split("\n")
    for cut in range(len(lines) - 1, 0, -1):
        old, new = "\n".join(lines[:cut]), "\n".join(lines[cut:])
        if old in text:
            at = text.rindex(old) if block.options.get("place") == "last" else text.index(old)
            return text[:at] + new + text[at + len(old) :]
    raise AssertionError(f"the tutorial edits what is not there: {block.text}")


def answers(expected: list[str], out: str) -> bool:
    """Whether the answer is as expected; ``…`` alone stands for any lines, within a line for any words."""
    pattern = ""
    for line in expected:
        if line.strip() == "…":
            pattern += r"(?:.*\n)*?"
        else:
            words = [re.escape(part) for part in re.split(r"\s*…\s*", line)]
            pattern += r"\s*" + ".*".join(words) + r"\s*?\n"
    return re.fullmatch(pattern, out if out.endswith("\n") else out + "\n") is not None


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    runtime = tempfile.mkdtemp(prefix="ms")
    yield {**os.environ, "XDG_RUNTIME_DIR": runtime, "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"}
    subprocess.run(
        [sys.executable, "-m", "midstride", "down"],
        env={**os.environ, "XDG_RUNTIME_DIR": runtime},
        capture_output=True,
        check=False,
        timeout=60,
    )
    shutil.rmtree(runtime)


def test_the_tutorial_can_be_done(tmp_path: Path, environment: dict[str, str]) -> None:
    commands = 0
    for block in blocks():
        if block.kind == "stride":
            (tmp_path / block.options["file"]).write_text(block.text, encoding="utf-8")
        elif block.kind == "edit":
            path = tmp_path / block.options["file"]
            path.write_text(edited(path.read_text(encoding="utf-8"), block), encoding="utf-8")
        else:
            assert block.kind == "console", block.kind
            for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
                command, *expected = part.rstrip("\n").split("\n")
                words = shlex.split(command)
                assert words[0] == "midstride"
                done = subprocess.run(
                    [sys.executable, "-m", *words],
                    cwd=tmp_path,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    capture_output=True,
                    text=True,
                    encoding="utf-8",
                    timeout=100,
                    check=False,
                )
                assert done.returncode == int(block.options.get("status", "0")), (command, done.stdout, done.stderr)
                assert answers(expected, done.stdout), f"$ {command}\n{done.stdout}\n-- instead of --\n" + "\n".join(
                    expected
                )
                commands += 1
    assert commands >= 12


def test_the_files_of_the_tutorial_are_canonical() -> None:
    from midstride.lang import format_text

    for block in blocks():
        if block.kind == "stride":
            assert format_text(block.text).text == block.text


def test_the_tutorial_takes_a_quarter_of_an_hour() -> None:
    """At 200 words a minute to read, and 120 characters a minute to type (the rest is copied)."""
    text = TUTORIAL.read_text(encoding="utf-8")
    typed = sum(
        len(line) for block in blocks() if block.kind == "console" for line in block.text.split("\n") if line[:1] == "$"
    )
    assert len(text.split()) / 200 + typed / 120 < 15
