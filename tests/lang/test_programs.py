"""The warning for a `run` that names a file that is not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.lang import load
from midstride.lang.catalogue_entry import CHATTER, NODE
from tests.examples import json_text

SYSTEM = CHATTER.replace("  output", '  run "RUN"\n  output') + NODE


def warned(folder: Path, run: str, name: str = "s.stride") -> list[str]:
    """The messages of W161 for a component that is started by ``run``."""
    (folder / name).write_text(SYSTEM.replace("RUN", run))
    loaded = load(folder / name)
    assert loaded.specification is not None
    return [found.message for found in loaded.diagnostics if found.code == "W161"]


@pytest.mark.parametrize(
    "run",
    [
        "python3 there.py",
        "python3 -u -X dev there.py --rate 3 other.py",
        "/usr/bin/env there",
        "./bin/there --x",
        "python3 -m package.node",
        "python3 -c pass",
        "ros2 run package node",
        "nowhere --x",
    ],
)
def test_what_is_there_or_cannot_be_known_is_not_warned_of(run: str, tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    for name in ("there.py", "bin/there"):
        (tmp_path / name).write_text("")
    assert warned(tmp_path, run) == []


@pytest.mark.parametrize(
    ("run", "file"),
    [
        ("python3 gone.py", "gone.py"),
        ("python3.11 -W error -u gone.py --x", "gone.py"),
        ("./nosuch --x", "nosuch"),
        ("/opt/none/python3 gone.py", "/opt/none/python3"),
    ],
)
def test_a_file_that_is_not_there_is_warned_of_at_its_place(run: str, file: str, tmp_path: Path) -> None:
    messages = warned(tmp_path, run)
    assert messages[0] == f"component Talker runs `{run}`, but there is no file {tmp_path / file}"
    found = next(d for d in load(tmp_path / "s.stride").diagnostics if d.code == "W161")
    assert found.position == (4, 7) and found.severity == "warning"


def test_a_name_that_is_nearly_right_is_suggested(tmp_path: Path) -> None:
    (tmp_path / "talker.py").write_text("")
    warned(tmp_path, "python3 talkr.py")
    assert [d.help for d in load(tmp_path / "s.stride").diagnostics] == ["did you mean `talker.py`?"]


def test_programs_of_an_included_file_are_in_the_folder_of_the_system(tmp_path: Path) -> None:
    """There they are started."""
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "talker.stride").write_text(
        SYSTEM.replace("system s\n", "").replace("RUN", "python3 talker.py")
    )
    (tmp_path / "s.stride").write_text('system s\ninclude "library/talker.stride"\n')
    (tmp_path / "library" / "talker.py").write_text("")
    assert [d.code for d in load(tmp_path / "s.stride").diagnostics] == ["W161"]
    (tmp_path / "talker.py").write_text("")
    assert load(tmp_path / "s.stride").diagnostics == ()


def test_json_is_warned_of_as_well_and_a_command_of_two_components_once(tmp_path: Path) -> None:
    text = json_text("talker")
    (tmp_path / "talker.json").write_text(text.replace("new_talker.py", "talker.py"))
    loaded = load(tmp_path / "talker.json")
    assert {d.message.partition(",")[0] for d in loaded.diagnostics} == {
        "component Listener runs `python3 listener.py`",
        "component NewTalker runs `python3 talker.py`",
    }
    lines = text.splitlines()
    assert all('"run"' in lines[d.position[0] - 1] for d in loaded.diagnostics)
