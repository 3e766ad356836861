"""The recording in the README shows what the commands print today, and no path of the machine that it was made on."""

from __future__ import annotations

import importlib.util
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def record() -> ModuleType:
    spec = importlib.util.spec_from_file_location("midstride_record", ROOT / "tools" / "record.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclass
    spec.loader.exec_module(module)
    return module


def last_picture(svg: str) -> list[str]:
    """The lines that are left at the end, from top to bottom, without numbers, widths, and the times of logs.

    Nor with the spread of measured durations, and the steps' own sum where it differs: they depend on the machine.
    """
    root = ElementTree.fromstring(svg)
    kept = set(re.findall(r"\.(t\d+)\{animation-name:t\d+;opacity:1\}", svg))
    lines = {
        int(text.attrib["y"]): "".join(text.itertext()) for text in root.iter(f"{SVG}text") if text.get("class") in kept
    }
    without = (re.sub(r"[\d:.]*\d( m?s)?", "#", lines[y]).replace("[#] ", "") for y in sorted(lines))
    return [" ".join(re.sub(r"\(# to #\)|, for steps of # in all", "", line).split()) for line in without]


@pytest.mark.full
def test_the_recording_shows_what_the_commands_print(record: ModuleType) -> None:
    """If this fails, the output of a command has changed: `make recording`."""
    kept = (ROOT / "docs" / "recording.svg").read_text(encoding="utf-8")
    assert last_picture(kept.replace("on ros2", "on sim")) == last_picture(record.record("sim"))
    for command in record.COMMANDS:
        assert f" {command}</tspan>" in kept


def test_a_private_path_is_refused(record: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "COMMANDS", ("pwd",))
    with pytest.raises(SystemExit, match="the output names"):
        record.record("sim")


def test_a_command_that_fails_is_not_recorded(record: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "COMMANDS", ("false",))
    with pytest.raises(SystemExit, match="has failed"):
        record.record("sim")


def test_what_a_row_shows_begins_and_ends(record: ModuleType) -> None:
    recorder = record.Recorder()
    recorder.write("one\r\n")
    recorder.wait(1)
    recorder.write("\x1b[31mtwo\x1b[0m\x1b[1;1H\x1b[2Kthree & four")
    recorder.wait(1)
    one, *rest = recorder.close()
    assert (one.row, one.start, one.end) == (0, 0, 1) and ">one<" in one.svg
    assert [(shown.row, shown.start, shown.end) for shown in sorted(rest, key=lambda shown: shown.row)] == [
        (0, 1, 2),
        (1, 1, 2),
    ]
    picture = record.svg([one, *rest], recorder.now)
    assert last_picture(picture) == ["three & four", "two"]
    assert record.COLOURS["red"] in picture
