"""What was found in launch files in Python, recorded where `launch` is and replayed elsewhere."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from midstride.launch_files.python_files import carried_out
from tests.launch_files.launched_processes import CATALOGUE, PACKAGE, shortened

Runner = Callable[[str, Mapping[str, Any], Mapping[str, str]], dict[str, Any]]


def recording(into: list[list[Any]], prefix: Path) -> Runner:
    """Carries out a file, and notes in ``into`` what was given and found."""

    def run(path: str, given: Mapping[str, Any], environment: Mapping[str, str]) -> dict[str, Any]:
        found = carried_out(path, given, environment)
        text = json.dumps([path, dict(given), found])
        written = dict.fromkeys(re.findall(r'/[^\s"]*/launch_params_\w+', text))
        for number, name in enumerate(written):
            text = text.replace(name, f"/written/{number}")
        into.append(json.loads(shortened(text, prefix)))
        return found

    return run


def replaying(recorded: list[list[Any]], prefix: Path) -> Runner:
    """Finds what was found for a file when it was given the same."""

    def run(path: str, given: Mapping[str, Any], environment: Mapping[str, str]) -> dict[str, Any]:
        asked = json.loads(shortened(json.dumps([path, dict(given)]), prefix))
        (found,) = (found for *known, found in recorded if known == asked)
        text = json.dumps(found)
        for name, folder in (("<share>", prefix / "share" / PACKAGE), ("<here>", CATALOGUE), ("<prefix>", prefix)):
            text = text.replace(name, str(folder))
        return dict(json.loads(text))

    return run
