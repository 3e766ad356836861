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
