"""Text as it is shown: what a terminal would carry out, or hide, is escaped, and nothing else."""

from __future__ import annotations

import pytest

from midstride.model.printable import on_one_line, printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain", "plain"),
        ("Größe 3 µm, 日本", "Größe 3 µm, 日本"),
        ("\x1b[2J", "\\x1b[2J"),
        ("a\u202eb", "a\\u202eb"),
        ("a\nb\tc", "a\nb\tc"),
        ("ü\nb", "ü\nb"),
        ("\u0915\u094d\u200d\u0937", "\u0915\u094d\u200d\u0937"),  # a joiner of a script
        ("a\u2028b", "a\\u2028b"),
    ],
)
def test_control_characters_are_escaped_and_letters_of_every_script_are_not(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_on_one_line_there_is_no_line_break() -> None:
    assert on_one_line("ä\nb\tc\x07") == "ä\\nb\\tc\\x07"
