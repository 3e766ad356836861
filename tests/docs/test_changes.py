"""The files in ``changes/``: each is well-formed, and ``make changelog`` has a line for it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
KINDS = ("added", "changed", "fixed", "removed")
MOST_LINES = 60  # of what CHANGELOG.md says of 0.1.0
NAME = re.compile(rf"\+[a-z0-9]+(-[a-z0-9]+)*\.({'|'.join(KINDS)})\.md")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.name != "README.md")


def faults(path: Path) -> list[str]:
    """What is wrong with the file of one change."""
    text, found = path.read_text(encoding="utf-8"), list[str]()
    if not NAME.fullmatch(path.name):
        found.append(f"is not named like +a-few-words.{KINDS[0]}.md")
    if "\n\n" in text.strip() or re.match(r"\s*([-*#]|\d+\.)\s", text):
        found.append("is not one paragraph of plain sentences")
    if not re.search(r"[.)]\s*\Z", text):
        found.append("has no full stop at its end")
    return found + [f"links to {link}" for link in LINK.findall(text) if not (ROOT / link).exists()]


def changelog(repository: Path) -> str:
    command = [sys.executable, "-m", "towncrier", "build", "--draft", "--version", "next", "--date", "today"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_each_change_is_well_formed() -> None:
    assert {path.name: found for path in files(ROOT / "changes") if (found := faults(path))} == {}


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("quicker.added.md", "It is quicker.", "is not named"),
        ("+quicker.better.md", "It is quicker.", "is not named"),
        ("+quicker.added.md", "- It is quicker.", "is not one paragraph"),
        ("+quicker.added.md", "It is quicker.\n\nMuch.", "is not one paragraph"),
        ("+quicker.added.md", "It is quicker", "has no full stop"),
        ("+quicker.added.md", "It is quicker ([how](docs/how.md)).", "links to docs/how.md"),
    ],
)
def test_a_change_that_is_not_is_found(tmp_path: Path, name: str, text: str, fault: str) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    [found] = faults(path)
    assert found.startswith(fault)


def test_the_changelog_has_a_line_for_each_change(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "CHANGELOG.md"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "changes", tmp_path / "changes")
    for kind in KINDS:
        path = tmp_path / "changes" / f"+test-of-a-change.{kind}.md"
        path.write_text(f"A thing was {kind}, and\nits text has two lines.\n", encoding="utf-8")
        assert faults(path) == []
    found = changelog(tmp_path).splitlines()
    for kind in KINDS:
        assert f"### {kind.capitalize()}" in found
        assert f"- A thing was {kind}, and" in found
    assert sum(line.startswith("- ") for line in found) == len(files(tmp_path / "changes"))


def test_the_changelog_of_the_first_version_is_short() -> None:
    before, heading, first = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition("## 0.1.0")
    assert before and heading
    assert len(first.partition("\n## ")[0].splitlines()) <= MOST_LINES
