"""Near misses: which name is suggested for a misspelt one, and where none is."""

from __future__ import annotations

import pytest

from midstride.model.near_miss import did_you_mean, nearest


@pytest.mark.parametrize(
    ("word", "known", "expected"),
    [
        ("tlaker", ["listener", "talker"], "talker"),
        ("topc", ["topic", "timing", "node"], "topic"),
        ("rnu", ["run", "uses"], "run"),
        ("Detekt", ["detect", "Detect"], "Detect"),
        ("E0012", ["E012", "E001"], "E001"),
        ("/smooth", ["/a/smooth", "/raw"], "/a/smooth"),
        ("scan", ["scan"], None),
        ("wibble", ["topic", "node"], None),
        ("a", ["b"], None),
        ("a" * 100, ["a" * 99], None),
        ("scan", [], None),
    ],
)
def test_the_nearest_name(word: str, known: list[str], expected: str | None) -> None:
    assert nearest(word, known) == expected


@pytest.mark.parametrize(
    ("word", "known", "expected"),
    [
        ("BooleanValue", ["Byte", "Bool"], "did you mean `Bool`?"),
        ("best", ["reliable", "best_effort"], "did you mean `best_effort`?"),
        ("bestEffort", ["best_effort_but_longer", "reliable"], "did you mean `best_effort_but_longer`?"),
        ("env", ["environment_of_all", "environment"], "did you mean `environment`?"),
        ("ab", ["abcdefgh"], None),
        ("Flag", ["Bool", "Byte"], None),
    ],
)
def test_an_abbreviation_is_near_as_well(word: str, known: list[str], expected: str | None) -> None:
    assert did_you_mean(word, known) == expected
