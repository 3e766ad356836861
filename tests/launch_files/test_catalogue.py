"""An import starts what ROS's own `launch` starts, for each launch file of a catalogue, or names what differs.

The answers of launch are in answers.json, written by `python -m tests.launch_files.launch_answers` where launch can be
imported. There, the last test compares with the launch that is installed.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from midstride.errors import SpecificationError
from midstride.launch_files import launch_interpreter
from midstride.launch_files.launch_import import import_launch_file
from tests.launch_files.imported_processes import imported
from tests.launch_files.launch_answers import ANSWERS
from tests.launch_files.launched_processes import CATALOGUE, cases, prefix_folder, surroundings
from tests.launch_files.recorded_python import replaying

DOCUMENT = json.loads(ANSWERS.read_text(encoding="utf-8"))
CASES = {name: (path, arguments) for name, path, arguments in cases()}


def test_the_catalogue_has_an_answer_for_each_file() -> None:
    assert set(CASES) == set(DOCUMENT["answers"]) and len(CASES) >= 150
    kinds = {ending: sum(name.endswith(ending) for name in CASES) for ending in (".xml", ".yaml", ".py")}
    assert min(kinds.values()) >= 20, kinds


@pytest.mark.parametrize("name", sorted(CASES))
def test_an_import_starts_what_launch_starts_or_says_what_differs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix = prefix_folder(tmp_path)
    monkeypatch.delenv("MADE_UP_UNSET", raising=False)
    monkeypatch.setattr(launch_interpreter, "carried_out", replaying(DOCUMENT["python"].get(name, []), prefix))
    different, said = imported(name, DOCUMENT["answers"], prefix, tmp_path)
    assert said or not different, different
    assert not different or name in DOCUMENT["differing"], (different, said)


def refused(name: str, folder: Path) -> list[str]:
    """What an import says that launch refuses a launch file for; what it says where it refuses it as well."""
    path, arguments = CASES[name]
    prefix = prefix_folder(folder)
    environment = surroundings(prefix, os.environ)
    try:
        found = import_launch_file(path, arguments, environment, folder / "a.stride", ros=2)
    except SpecificationError as error:
        return [str(error)]
    return [str(each) for each in found.findings if each.kind == "refused"]


@pytest.mark.parametrize("name", sorted(name for name in CASES if not name.endswith(".py")))
def test_a_launch_file_is_said_to_be_refused_if_launch_does_not_read_it(name: str, tmp_path: Path) -> None:
    """Or does not start a process for what stands there."""
    error = DOCUMENT["answers"][name].get("error", "")
    read = not error.startswith("Caught multiple exceptions") or "No such file" in error
    if read and name.startswith("refused-"):
        assert error and refused(name, tmp_path)
    else:
        assert bool(refused(name, tmp_path)) is not read, error


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="ROS 2's launch is on no package index")
def test_the_same_holds_for_the_launch_that_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    to = tmp_path / "answers.json"
    monkeypatch.delenv("MADE_UP_UNSET", raising=False)
    command = [sys.executable, "-m", "tests.launch_files.launch_answers", "--to", str(to)]
    subprocess.run(command, cwd=CATALOGUE.parent.parent.parent, check=True, stdout=subprocess.DEVNULL)
    answers = json.loads(to.read_text(encoding="utf-8"))
    prefix = prefix_folder(tmp_path)
    silent = {}
    for name in sorted(CASES):
        different, said = imported(name, answers["answers"], prefix, tmp_path)
        if different and not said:
            silent[name] = different
    assert silent == {}
    if answers["versions"] == DOCUMENT["versions"]:
        assert answers["answers"] == DOCUMENT["answers"]
