"""The text of a specification that the page sends: diagnostics with their places, and no file is read for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.codec.reading import decode_form
from midstride.codec.specification_form import decode_specification
from midstride.errors import SpecificationError
from midstride.server.checked_text import checked
from midstride.server.requests import SubmittedText
from tests.examples import json_form, json_text
from tests.server.scripted import EXAMPLES

TALKER = (EXAMPLES / "talker" / "talker.stride").read_text(encoding="utf-8")


def test_a_correct_text_can_be_applied() -> None:
    result = checked(SubmittedText(text=TALKER, name="talker.stride"))
    assert result.ok and result.request is not None and result.request.to is not None
    assert result.request.to.specification() == decode_specification(json_form("talker"))


def test_json_is_told_by_its_name() -> None:
    text = json_text("talker")
    assert checked(SubmittedText(text=text, name="talker.json")).ok
    assert not checked(SubmittedText(text=text, name="talker.stride")).ok


def test_a_problem_has_its_place() -> None:
    lines = TALKER.splitlines()
    (index,) = [number for number, line in enumerate(lines) if line.strip().startswith("node talker")]
    lines[index] = lines[index].replace("Talker", "Talkre")
    result = checked(SubmittedText(text="\n".join(lines), name="../../etc/edited.stride"))
    assert not result.ok and result.request is None
    (problem,) = [each for each in result.diagnostics if each.severity == "error"]
    assert (problem.file, problem.line) == ("edited.stride", index + 1)
    assert lines[index][problem.column - 1 :].startswith("Talkre")
    assert "Talker" in (problem.help or "")


@pytest.mark.parametrize(("statement", "name"), [('include "{}"', "part.stride"), ('parameters "{}"', "values.yaml")])
def test_no_file_is_read(statement: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("secret: 1")
    text = TALKER + "\n" + statement.format(name) + "\n"
    result = checked(SubmittedText(text=text))
    assert not result.ok and result.request is None
    (problem,) = [each for each in result.diagnostics if each.severity == "error"]
    assert "no file is read for a text that is sent to the manager" in problem.message
    assert "midstride apply FILE" in (problem.help or "")
    assert problem.line == len(TALKER.splitlines()) + 2
    assert "secret" not in repr(result)


def test_a_name_that_no_file_can_have_is_refused() -> None:
    with pytest.raises(SpecificationError, match="a file's name"):
        decode_form({"text": TALKER, "name": "a\0b"}, SubmittedText)
