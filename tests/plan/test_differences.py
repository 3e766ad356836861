"""How two specifications differ, told in the model's words."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given

from midstride.lang import load_text
from midstride.model.specification import Specification
from midstride.plan.specification_diff import differences
from tests.strategies.systems import specifications

FOLDER = Path(__file__).parents[1] / "lang" / "seeds"
TEXT = (FOLDER / "patrol.stride").read_text(encoding="utf-8")


def changed(*replacements: tuple[str, str]) -> list[str]:
    text = TEXT
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    before, after = (load_text(t, str(FOLDER / "patrol.stride")).require() for t in (TEXT, text))
    return [str(difference) for difference in differences(before, after)]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "node detector   : ObstacleDetector {",
            "node detector   : ObstacleDetector { parameters { threshold = 0.5 }",
            ["node detector: set\n  parameter threshold: 0.4 -> 0.5, set in place"],
        ),
        (
            "node detector   : ObstacleDetector {",
            'node detector   : ObstacleDetector { parameters { model = "big.onnx" }',
            ["node detector: replaced\n  parameter model: small.onnx -> big.onnx"],
        ),
        (
            "node detector   : ObstacleDetector",
            "node detector   : StereoDetector",
            ["node detector: replaced\n  component: ObstacleDetector -> StereoDetector"],
        ),
        (
            "out -> /obstacles }",
            "}",
            ["node detector: rewired\n  out is detached from /obstacles"],
        ),
        (
            "limit detector.detect below baseline 2 s",
            "limit detector.detect below baseline 3 s",
            [
                "constraint `limit detector.detect below baseline 2 s`: removed",
                "constraint `limit detector.detect below baseline 3 s`: added",
            ],
        ),
        (
            "{ publishers <= 1 }",
            "",
            ["topic /cmd_vel: changed\n  publishers: at most 1 -> any number"],
        ),
        (
            "resource gpu_memory = 8192",
            "resource gpu_memory = 4096",
            ["resource gpu_memory: changed\n  capacity: 8192 -> 4096"],
        ),
        ("create 0.5 s", "create 0.6 s", ["timing: changed\n  step create: 0.5 -> 0.6"]),
        (
            "control weight 10",
            "control weight 11",
            [
                "component MotorController: changed\n  functionality control: weight: 10 -> 11",
                "node controller: replaced\n  component MotorController is declared differently",
            ],
        ),
    ],
)
def test_each_difference_in_its_words(old: str, new: str, told: list[str]) -> None:
    assert changed((old, new)) == told


def test_a_parameter_is_set_in_place_only_if_it_is_changeable_before_and_after() -> None:
    """As the planner judges it: what runs must be able to change it, too."""
    told = changed(('model = "small.onnx"', 'changeable model = "big.onnx"'))
    assert "node detector: replaced\n  parameter model: small.onnx -> big.onnx" in told


def test_the_order_in_which_a_declaration_is_written_is_no_difference() -> None:
    first, second = (f"assume {what.ljust(31)}#" for what in ("scan", "Camera"))
    assert TEXT.count(first) == TEXT.count(second) == 1
    assert changed((first, "assume Camera #"), (second, "assume scan #")) == []


def test_blanks_and_names_of_contracts_are_no_difference() -> None:
    assert (
        changed(
            ("contract Camera =", "contract Colour ="), ("assume Camera", "assume Colour"), ("  input", "\n  input")
        )
        == []
    )


def test_another_contract_is_another_topic() -> None:
    (told,) = changed(
        ("topic /odom      : nav_msgs/msg/Odometry @ 50 Hz", "topic /odom : nav_msgs/msg/Odometry @ 40 Hz")
    )
    assert told.startswith(
        "topic /odom: changed\n  contract: nav_msgs/msg/Odometry @ 50 Hz -> nav_msgs/msg/Odometry @ 40 Hz\n"
    )


def test_services_and_their_ports_are_called_so() -> None:
    served = """system s
service /map : nav_msgs/srv/GetMap responds within 50 ms
action /dock : nav2_msgs/action/Dock
component A {
  run "./a" gate preload
  server map as get_map
  action client dock : nav2_msgs/action/Dock
  functionality f { produces map  mode on { guarantee map : nav_msgs/srv/GetMap responds within 50 ms }  mode off { } }
}
node a : A { map -> /map  dock <- /dock }
"""
    before = load_text(served).require()
    faster = load_text(served.replace("50 ms", "20 ms").replace("as get_map", "as ~/map")).require()
    without = load_text('system s\ncomponent A {\n  run "./a" gate preload\n}\nnode a : A').require()
    words = [str(each) for each in differences(before, faster)]
    assert any(each.startswith("service /map: changed\n") and "makes a new service:" in each for each in words)
    assert any("\n  service of map: get_map -> ~/map" in each for each in words)
    words = [str(each) for each in differences(before, without)]
    assert words[:2] == ["service /map: removed", "ROS action /dock: removed"]
    assert any("\n  server map: removed" in each and "\n  action client dock: removed" in each for each in words)
    assert "topic" not in " ".join(words)


@given(specifications(), specifications())
def test_there_is_a_difference_iff_they_differ(one: Specification, other: Specification) -> None:
    assert differences(one, one) == []
    differ = bool(differences(one, other))
    assert differ == bool(differences(other, one))
    if not differ:
        assert one.nodes == other.nodes
        assert one.connectors == other.connectors


def test_a_component_that_is_only_renamed_is_renamed() -> None:
    assert changed(("ObstacleDetector", "Detector")) == [
        "component ObstacleDetector: renamed\n  to Detector; its nodes keep running"
    ]
    both = changed(("ObstacleDetector", "Detector"), ("functionality detect weight 3", "functionality detect weight 4"))
    assert not any("renamed" in difference for difference in both)


def test_a_node_is_replaced_where_its_code_has_changed() -> None:
    (specification,) = [load_text(TEXT, str(FOLDER / "patrol.stride")).require()]
    found = differences(specification, specification, {"detector": "code changed on disk: detector.py"})
    assert [str(difference) for difference in found] == ["node detector: replaced\n  code changed on disk: detector.py"]
