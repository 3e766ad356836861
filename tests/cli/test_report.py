"""``report``, and ``plan --html``: one file, with what the command line prints."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import EXAMPLES, Midstride

TALKER = str(EXAMPLES / "talker" / "talker.stride")


def data_of(file: Path) -> Any:
    [data] = re.findall(r'<script type="application/json" id="data">(.*?)</script>', file.read_text(), re.DOTALL)
    return json.loads(data)


@pytest.mark.full
def test_a_change_is_written_with_what_its_command_has_reported(midstride: Midstride, tmp_path: Path) -> None:
    assert midstride("up", TALKER, "--backend", "sim", "--detach").status == 0
    outcome = midstride("replace", "talker", "NewTalker", "--yes", "--json").json
    file = tmp_path / "change.html"
    done = midstride("report", "-o", str(file))
    assert done.status == 0 and str(file) in done.out
    data = data_of(file)
    assert data["system"] == "talker" and data["backend"] == "sim" and data["change"]["change"]["number"] == 2
    assert data["change"]["outcome"]["swaps"] == outcome["swaps"]
    assert data["change"]["plan"]["steps"] == outcome["plan"]["steps"]
    assert [each["name"] for each in data["after"]["instances"]] == ["listener", "talker_2"]
    up = midstride("report", "--change", "1", "--json").json
    assert up["change"]["command"] == "up"
    unknown = midstride("report", "-o", str(file), "--change", "7")
    assert unknown.status == 1 and "the history has no change 7" in unknown.err


def test_a_plan_is_written_before_its_change(midstride: Midstride, tmp_path: Path) -> None:
    file = tmp_path / "plan.html"
    options = ("plan", TALKER, "--replace", "talker=NewTalker")
    plan = midstride(*options, "--html", str(file), "--json").json
    data = data_of(file)
    assert data["change"] is None and data["plans"] == {"minimal": plan} and data["before"]["instances"]
    assert midstride(*options, "--compare", "--html", str(file)).status == 0
    assert list(data_of(file)["plans"]) == ["minimal", "paper", "quiesce", "stop"]
    nowhere = midstride(*options, "--html", str(tmp_path / "no" / "plan.html"))
    assert nowhere.status == 1 and "cannot write" in nowhere.err
