"""The words of the project are those of docs/style.md, as far as `tools/words.py` finds others."""

from __future__ import annotations

import pytest

from tools.words import faults, files, leaning, phrases


def test_nothing_is_found() -> None:
    assert len(list(files())) > 500
    found = faults()
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("words", "leans"),
    [
        ("Whether it runs.", True),
        ("What has been seen.", True),
        ("Its name.", True),
        ("How many run.", True),
        ("Why it failed.", True),
        ("Return whether the process runs.", False),
        ("Items of a list.", False),
    ],
)
def test_such_an_opening_is_found(words: str, leans: bool) -> None:
    assert bool(list(leaning(f'def f():\n    """{words}"""\n'))) is leans


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("one\nWhile the components go on.\n", 2),
        ("one\n# and the other nodes\n# go on, too\n", 2),
        ("Its nodes go on.", 1),
        ("The gates are to go.", 1),
        ("It is to go.", 1),
        ("The gate goes on line 3.", None),
    ],
)
def test_such_a_phrase_is_found_with_its_line(text: str, line: int | None) -> None:
    assert [each.partition(":")[0] for each in phrases(text)] == ([] if line is None else [str(line)])
