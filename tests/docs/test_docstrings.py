"""The docstrings of the source stand without the name above them: none opens with a word that leans on it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LEANING = re.compile(r"(?:What|Whether|Those|That|These|It|Its|As|The same)\b")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def leaning(source: str) -> Iterator[str]:
    """The line and the opening of each docstring that begins with such a word."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED):
            words = ast.get_docstring(node)
            if words and LEANING.match(words):
                yield f"{node.body[0].lineno}: {words.splitlines()[0]}"


def test_no_docstring_opens_with_a_word_that_leans_on_the_name_above_it() -> None:
    files = sorted((ROOT / "src").rglob("*.py"))
    assert len(files) > 400
    found = [f"{path.relative_to(ROOT)}:{each}" for path in files for each in leaning(path.read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("words", "leans"),
    [
        ("Whether it runs.", True),
        ("What has been seen.", True),
        ("Its name.", True),
        ("Return whether the process runs.", False),
        ("Items of a list.", False),
    ],
)
def test_such_an_opening_is_found(words: str, leans: bool) -> None:
    assert bool(list(leaning(f'def f():\n    """{words}"""\n'))) is leans
