"""The design decisions: each file has every field, names modules that exist, and is in the index once."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DECISIONS = ROOT / "docs" / "decisions"
FILES = sorted(path for path in DECISIONS.glob("*.md") if path.name != "README.md")
SECTIONS = ["Question", "Decision", "Rejected", "Price"]
STATUS = re.compile(r"accepted|superseded by \[[^]]+\]\([a-z0-9-]+\.md\)|withdrawn: .+")
LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")


def faults(path: Path) -> list[str]:
    """What is wrong with the file of a decision."""
    text, found = path.read_text(encoding="utf-8"), list[str]()
    head, *sections = re.split(r"^## ", text, flags=re.MULTILINE)
    form = re.fullmatch(r"# .+\n\n- \*\*Status:\*\* (.+)\n- \*\*Modules:\*\* (.+)\n\n", head)
    if form is None:
        return ["needs a title, its status and its modules, and nothing else before the question"]
    if not STATUS.fullmatch(form[1]):
        found.append(f"has the status {form[1]}")
    if not re.fullmatch(r"`[^`]+`(, `[^`]+`)*", form[2]):
        found.append("has modules that are not a list of paths")
    for module in re.findall(r"`([^`]+)`", form[2]):
        if not any((folder / module).is_file() for folder in (ROOT / "src" / "midstride", ROOT)):
            found.append(f"names {module}")
    if [section.partition("\n")[0] for section in sections] != SECTIONS:
        found.append(f"needs the sections {', '.join(SECTIONS)}")
    found += [
        f"has an empty section {name}" for name, _, rest in (s.partition("\n") for s in sections) if not rest.strip()
    ]
    return found + [f"links to {link}" for link in LINK.findall(text) if not (DECISIONS / link).exists()]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_each_decision_has_every_field(path: Path) -> None:
    assert faults(path) == []


def test_the_index_has_each_decision_once() -> None:
    text = (DECISIONS / "README.md").read_text(encoding="utf-8")
    assert sorted(LINK.findall(text)) == [path.name for path in FILES]
    assert len(FILES) > 100


GOOD = """# A title

- **Status:** accepted
- **Modules:** `wire/cut_locks.py`

## Question

Which?

## Decision

This one.

## Rejected

- Another.

## Price

None known.
"""


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("# A title\n", "", "needs a title"),
        ("- **Status:** accepted\n", "", "needs a title"),
        ("accepted", "tried", "has the status tried"),
        ("accepted", "withdrawn", "has the status withdrawn"),
        ("`wire/cut_locks.py`", "`wire/cut_lock.py`", "names wire/cut_lock.py"),
        ("`wire/cut_locks.py`", "wire", "has modules that"),
        ("## Rejected\n\n- Another.\n\n", "", "needs the sections"),
        ("None known.\n", "", "has an empty section Price"),
        ("This one.", "[This](one.md).", "links to one.md"),
    ],
)
def test_a_fault_in_a_decision_is_found(tmp_path: Path, old: str, new: str, fault: str) -> None:
    path = tmp_path / "decision.md"
    path.write_text(GOOD, encoding="utf-8")
    assert faults(path) == []
    path.write_text(GOOD.replace(old, new), encoding="utf-8")
    [found] = faults(path)
    assert found.startswith(fault)
