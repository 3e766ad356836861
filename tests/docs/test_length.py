"""The documentation stays short: its words in all, and those of a page, as `wc -w` counts them."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST = 70_000
MOST_ON_A_PAGE = 2500
# Pages in which one looks something up, instead of reading them.
REFERENCES = {"docs/benchmarks.md", "docs/semantics.md"}
# What the source generates, decisions, and what others wrote.
NOT_COUNTED = re.compile(r"docs/(reference|decisions)/|.*/vendor/")


def words() -> dict[str, int]:
    """The words of each page, its snippets included."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    pages = [page for page in listed.splitlines() if not NOT_COUNTED.match(page) and (ROOT / page).is_file()]
    return {page: len((ROOT / page).read_text(encoding="utf-8").split()) for page in pages}


def test_the_documentation_has_fewer_than_70_000_words() -> None:
    counted = words()
    assert len(counted) > 50
    assert sum(counted.values()) < MOST, sorted(counted.items(), key=lambda each: -each[1])[:20]


def test_no_page_but_a_reference_has_more_than_2_500_words() -> None:
    counted = words()
    assert {page: number for page, number in counted.items() if number > MOST_ON_A_PAGE} == {
        page: counted[page] for page in REFERENCES
    }
