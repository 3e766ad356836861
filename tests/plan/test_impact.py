"""Impact: what falls when a node is gone, held against a system planned without it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given

from midstride.errors import PlanRefused
from midstride.lang import load
from midstride.model.specification import Specification, initial
from midstride.plan.impact import impacts
from tests.strategies.systems import specifications

SAMPLE = load(Path(__file__).parents[1] / "lang" / "seeds" / "patrol.stride").require()


def test_single_points_of_failure_come_first_and_reasons_are_told() -> None:
    lidar, detector, controller = impacts(SAMPLE)
    assert (lidar.role, lidar.single_point_of_failure, lidar.loss) == ("lidar", True, 16)
    assert [(fall.functionality, fall.before, fall.after, fall.levels) for fall in lidar.impacted] == [
        ("controller.control", "normal", "stop", 1),
        ("detector.detect", "normal", "degraded", 2),
    ]
    assert "/obstacles" in lidar.impacted[0].because[0]
    assert (detector.role, detector.loss) == ("detector", 10)
    assert (controller.role, controller.single_point_of_failure, controller.impacted) == ("controller", False, ())
    assert controller.own == ("control",)


def test_a_node_that_is_none_is_refused_with_a_near_miss() -> None:
    with pytest.raises(PlanRefused, match="there is no node `lidr`; did you mean `lidar`"):
        impacts(SAMPLE, ["lidr"])


SHARED = """system shared
topic /a : std_msgs/msg/String @ 10 Hz
topic /b : std_msgs/msg/String @ 10 Hz
container box
component Talker {
  run component "demo::Talker" package "demo" gate preload
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode degraded { }
  }
}
component Listener {
  run "listen" gate preload
  input in : std_msgs/msg/String @ 10 Hz
  functionality hear {
    uses in
    mode normal { assume in }
    mode off { }
  }
}
node a : Talker in box { out -> /a }
node b : Talker in box { out -> /b }
node hears_a : Listener { in <- /a }
node hears_b : Listener { in <- /b }
"""


def test_a_crash_of_a_container_is_the_crash_of_all_its_nodes(tmp_path: Path) -> None:
    path = tmp_path / "s.stride"
    path.write_text(SHARED, encoding="utf-8")
    specification = load(path).require()
    found = {each.role: each for each in impacts(specification)}
    box = found["box"]
    assert (box.component, box.own, box.together) == ("component_container", ("a.talk", "b.talk"), ("a", "b"))
    assert [each.functionality for each in box.impacted] == ["hears_a.hear", "hears_b.hear"]
    assert box.single_point_of_failure
    assert [each.functionality for each in found["a"].impacted] == ["hears_a.hear"], "it may also be removed alone"
    assert (found["a"].together, found["hears_a"].together) == (("b",), ())
    assert impacts(specification, ["box"]) == [box]
    with pytest.raises(PlanRefused, match="there is no node or container `bux`; did you mean `box`"):
        impacts(specification, ["bux"])


@given(specifications())
def test_what_falls_is_what_stands_lower_in_the_system_without_the_node(specification: Specification) -> None:
    """The slow and obvious way: take the node out and start again."""
    before = initial(specification)
    for impact in impacts(specification):
        after = initial(specification.without_node(impact.role))
        fallen = {ref: (before.modes[ref], index) for ref, index in after.modes.items() if index != before.modes[ref]}
        told = {fall.functionality: fall for fall in impact.impacted}
        assert set(told) == {str(ref) for ref in fallen}
        for ref, (stood, stands) in fallen.items():
            assert told[str(ref)].levels == stands - stood > 0
            assert told[str(ref)].after == before.functionality(ref).modes[stands].name
