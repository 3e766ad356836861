"""``python -m tools.changelog_rst [VERSION DATE]``: prints CHANGELOG.rst, which catkin's tools and bloom read.

The next version has the fragments in changes/, the others what CHANGELOG.md says of them. Its heading is `Forthcoming`,
which those tools do not count as a version, unless VERSION and DATE are given. docs/how-to/ros-package.md says when.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
KINDS: Final = ("added", "changed", "fixed", "removed")
_LINK: Final = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_VERSION: Final = re.compile(r"^## (\S+) \(([^)]*)\)\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d")
_ITEM: Final = re.compile(r"^- (.*(?:\n(?!- |#).*)*)", re.MULTILINE)


def as_rst(text: str) -> str:
    """A paragraph of Markdown on one line of reStructuredText: links are their words, code has two backquotes."""
    words = _LINK.sub(r"\1", " ".join(text.split())).replace("\\", "\\\\")
    parts = words.split("`")
    outside, inside = parts[0::2], parts[1::2]
    escaped = [re.sub(r"([*_|])", r"\\\1", part.replace("**", "")) for part in outside]
    return "".join(a + (f"``{b}``" if b else "") for a, b in zip(escaped, [*inside, ""], strict=False))


def _section(title: str, items: Iterator[str]) -> str:
    lines = "".join(f"* {as_rst(item)}\n" for item in items)
    return f"{title}\n{'-' * len(title)}\n{lines}\n"


def changelog(root: Path = ROOT, heading: str = "Forthcoming") -> str:
    """All of CHANGELOG.rst, with the heading of the next version.

    A version without a date in CHANGELOG.md is not released, and is part of the next one.
    """
    fragments = [
        path.read_text(encoding="utf-8") for kind in KINDS for path in sorted((root / "changes").glob(f"+*.{kind}.md"))
    ]
    released, ahead = [], [*fragments]
    for version, date, text in _VERSION.findall((root / "CHANGELOG.md").read_text(encoding="utf-8")):
        items = _ITEM.findall(text)
        if _DATE.fullmatch(date):
            released.append(_section(f"{version} ({date})", iter(items)))
        else:
            ahead += items
    title = "Changelog for package midstride"
    bar = "^" * len(title)
    return f"{bar}\n{title}\n{bar}\n\n" + "".join([_section(heading, iter(ahead)), *released])


if __name__ == "__main__":
    words = sys.argv[1:]
    if words and not (len(words) == 2 and re.fullmatch(r"\d+\.\d+\.\d+", words[0]) and _DATE.fullmatch(words[1])):
        sys.exit(f"{__doc__}\nA version is like 0.2.0, a date like 2026-11-28.")
    print(changelog(heading=f"{words[0]} ({words[1]})" if words else "Forthcoming"), end="")
