"""Modes as sets of ROS parameters, which are set on entry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.lang import format_text
from midstride.lang.load import load
from midstride.model.rules import violations
from midstride.model.specification_checks import check, errors
from midstride.plan.request import PlanRequest
from midstride.plan.specification_diff import differences
from midstride.runtime.manager import Manager
from midstride.simulation.stand_in import with_stand_ins
from tests.foreign.simulated import SimulatedRos, managed

TEXT = """system drive

topic /scan : sensor_msgs/msg/LaserScan @ 10 Hz

component Lidar {
  run "lidar" gate none
  output scan
  functionality sense {
    produces scan
    mode normal { guarantee scan : sensor_msgs/msg/LaserScan @ 10 Hz }
    mode degraded { }
  }
}

component Driver {
  run "driver" gate GATE
  parameters { speed = 1.0, gain = 2, name = "x" }
  input scan : sensor_msgs/msg/LaserScan @ 10 Hz
  functionality drive {
    uses scan
    mode normal {
      assume scan
      parameters { gain = 5 }
    }
    mode slow {
      parameters { speed = 0.25 }
    }
    mode degraded { }
  }
}

node lidar  : Lidar  { scan -> /scan }
node driver : Driver { scan <- /scan }
"""
REMOVE = PlanRequest(remove=("lidar",))


@pytest.mark.parametrize("gate", ["none", "lifecycle"])
def test_a_mode_sets_its_parameters_and_what_other_modes_set(gate: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        lidar, driver = manager.specification.nodes["lidar"], simulator.nodes["driver"]
        assert driver.values == {"speed": 1.0, "gain": 5, "name": "x", "own": 1.5}
        assert (await manager.change(REMOVE)).outcome == "done"
        assert simulator.events == ["driver set gain=2 speed=0.25", "lidar ended"]
        assert {type(driver.values[name]) for name in ("speed", "gain")} == {float, int}
        assert driver.state == ("unconfigured" if gate == "none" else "active")
        assert (await manager.change(PlanRequest(add=(lidar,)))).outcome == "done"
        assert driver.values == {"speed": 1.0, "gain": 5, "name": "x", "own": 1.5}
        assert violations(manager.configuration) == []
        # They are not taken over as values that were set at run time.
        outcome = await manager.change(PlanRequest(restart=("driver",)))
        assert (outcome.outcome, outcome.parameters) == ("done", [])

    managed(tmp_path, TEXT.replace("GATE", gate), body)


@pytest.mark.parametrize("gate", ["none", "lifecycle"])
def test_a_value_that_is_refused_fails_the_step(gate: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        driver.rejects["speed"] = "0.25 is too slow"
        outcome = await manager.change(REMOVE)
        assert outcome.outcome == "rolled_back"
        assert "driver refuses gain = 2, speed = 0.25: 0.25 is too slow" in str(outcome.because)
        assert driver.values["gain"] == 5  # none of them was set
        assert sorted(simulator.nodes) == ["driver", "lidar"]
        assert (await manager.status()).valid

    managed(tmp_path, TEXT.replace("GATE", gate), body)


def test_mode_parameters_are_read_written_and_compared(tmp_path: Path) -> None:
    text = TEXT.replace("GATE", "preload")
    path = tmp_path / "drive.stride"
    path.write_text(text, encoding="utf-8")
    assert format_text(text).text == text
    specification = load(path).require()
    slow = specification.components["Driver"].functionalities["drive"].modes[1]
    assert dict(slow.parameters) == {"speed": 0.25}
    document = encode_specification(specification)
    assert decode_specification(document) == specification
    path.write_text(text.replace("0.25", "0.5"), encoding="utf-8")
    other = load(path).require()
    assert not other.components["Driver"].same_body(specification.components["Driver"])
    found: Any = [each for each in differences(specification, other) if each.subject == "component Driver"]
    assert found[0].details == ("functionality drive, mode slow: parameters: speed = 0.25 -> speed = 0.5",)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (" gate GATE", "", "mode normal of drive sets gain, but Driver uses Midstride's API"),
        ("speed = 0.25", "sped = 0.25", "mode slow of drive sets sped, which Driver does not declare"),
        ("speed = 0.25", 'speed = "a"', "mode slow of drive sets speed to a string, and it is declared as a float"),
        ("      parameters { gain = 5 }\n", "", None),
        ("parameters { speed = 0.25 }", 'parameters "a.yaml"', "expected `{` after `parameters`"),
        ("speed = 0.25", "changeable speed = 0.25", "a mode sets the value of a parameter only"),
        ("speed = 0.25", "speed = 0.25, speed = 1.0", "duplicate parameter `speed`"),
        ("      parameters { gain = 5 }\n", "      # parameters { }\n", None),
    ],
)
def test_what_is_wrong_with_them_is_reported(before: str, after: str, message: str | None, tmp_path: Path) -> None:
    path = tmp_path / "drive.stride"
    path.write_text(TEXT.replace(before, after).replace("GATE", "preload"), encoding="utf-8")
    found = [each.message for each in load(path).diagnostics if each.severity == "error"]
    assert any(message in each for each in found) if message else not found, found


def test_a_simulation_runs_without_them(tmp_path: Path) -> None:
    path = tmp_path / "drive.stride"
    text = TEXT.replace('"driver" gate GATE', '"driver" package "drive_nodes" gate preload')
    path.write_text(text, encoding="utf-8")
    assert errors(check(with_stand_ins(load(path).require()))) == []


def test_a_mode_between_that_sets_nothing_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "drive.stride"
    text = TEXT.replace("parameters { speed = 0.25 }", "").replace("parameters { gain = 5 }", "")
    path.write_text(text.replace("GATE", "preload"), encoding="utf-8")
    found = [each.message for each in load(path).diagnostics if each.severity == "error"]
    assert found == ["mode slow of drive does the same as the normal mode"]


def test_a_mode_that_is_not_entered_leaves_the_parameters_of_the_one_before(tmp_path: Path) -> None:
    """They are set first; then the node does not make the transition that the mode needs."""

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        outcome = await manager.change(REMOVE)
        assert outcome.outcome == "rolled_back"
        assert "driver has answered `deactivate` with a failure; it is active" in str(outcome.because)
        driver = simulator.nodes["driver"]
        assert (driver.state, driver.values["gain"]) == ("active", 5)
        assert (await manager.status()).valid

    slow = "    mode slow {\n      parameters { speed = 0.25 }\n    }\n"
    text = TEXT.replace(f"{slow}    mode degraded {{ }}", "    mode degraded { parameters { gain = 1 } }")
    text = text.replace("GATE", "lifecycle")
    managed(tmp_path, text, body, {"Driver": {"refuses": {"deactivate"}}})
