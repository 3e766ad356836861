"""An import starts what roslaunch starts, for each launch file of a catalogue, or names what roslaunch refuses.

The answers of roslaunch (1.16) are in roslaunch_answers.json, which tests.launch_files.roslaunched writes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.launch_files.roslaunched import ANSWERS, ENVIRONMENT, cases, imported

DOCUMENT = json.loads(ANSWERS.read_text(encoding="utf-8"))
CASES = {name: (path, arguments) for name, path, arguments in cases()}


def test_the_catalogue_has_an_answer_for_each_file() -> None:
    assert set(CASES) == set(DOCUMENT)


@pytest.mark.parametrize("name", sorted(CASES))
def test_an_import_starts_what_roslaunch_starts_or_says_what_that_refuses(name: str, tmp_path: Path) -> None:
    path, words = CASES[name]
    answer = DOCUMENT[name]
    found = imported(path, dict(word.split(":=", 1) for word in words), tmp_path, ENVIRONMENT)
    if "error" in answer:
        assert "error" in found or any(found["said"].values()), answer
        return
    assert comparable(found["nodes"]) == comparable(answer["nodes"])
    assert comparable(found["parameters"]) == comparable(answer["parameters"])
    assert not any(": refused: " in each for each in found["said"])


def comparable(found: dict[str, Any]) -> dict[str, str]:
    """Each value with its type; a list of numbers may have none that is an integer."""
    return {name: json.dumps(_numbers(value), sort_keys=True) for name, value in found.items()}


def _numbers(value: Any) -> Any:
    mixed = isinstance(value, list) and {type(each) for each in value} == {int, float}
    return [float(each) for each in value] if mixed else value
