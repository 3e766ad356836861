"""The examples in the language: canonical, accepted, and the same systems when they are written as JSON and read."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.lang import format_text, load, render
from tests.examples import json_text

ROOT = Path(__file__).parents[2] / "examples"
SYSTEMS = ("talker", "filter", "obstacle", "autoware_control", "patrol")


@pytest.mark.parametrize("path", sorted(ROOT.glob("*/*.stride")), ids=lambda path: path.stem)
def test_every_file_is_in_canonical_form(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert format_text(text).text == text


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_is_accepted_without_a_warning(name: str) -> None:
    loaded = load(ROOT / name / f"{name}.stride")
    assert loaded.diagnostics == (), render(loaded.diagnostics)


@pytest.mark.parametrize("name", SYSTEMS)
def test_its_json_form_is_the_same_system(name: str, tmp_path: Path) -> None:
    written = tmp_path / f"{name}.json"
    written.write_text(json_text(name), encoding="utf-8")
    assert load(written).require() == load(ROOT / name / f"{name}.stride").require()


def test_with_the_vehicles_figure_it_is_said_what_breaks_where_and_what_follows() -> None:
    loaded = load(ROOT / "autoware_control" / "vehicle.stride")
    lines = (ROOT / "autoware_control" / "control_loop.stride").read_text(encoding="utf-8").splitlines()
    assert [diagnostic.code for diagnostic in loaded.diagnostics] == ["E020", "E020"]
    for diagnostic, what in zip(loaded.diagnostics, ("kinematic_state", "acceleration"), strict=True):
        assert diagnostic.message == (
            f"/localization/{what} does not satisfy what controller.{what} assumes: "
            "rate: 40 Hz is offered, at least 50 Hz is needed"
        )
        line, column = diagnostic.position
        assert lines[line - 1][column - 1 :] == f"/localization/{what}"
        assert [note.message for note in diagnostic.notes] == ["contract of the topic", "contract of the port"]
        assert diagnostic.follows is not None
        assert diagnostic.follows.startswith("controller.follow will be in mode silent, ")
        assert "vehicle_cmd_gate.pass_on will be in mode closed" in diagnostic.follows
        assert "autonomous_emergency_braking.brake will be in mode without_prediction" in diagnostic.follows
        assert "collision_detector" not in diagnostic.follows
