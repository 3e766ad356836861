"""What registers must be what the specification declares: guarantees no weaker, assumptions no stronger."""

from __future__ import annotations

from dataclasses import replace

import pytest
from immutables import Map

from midstride.lang import load_text
from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode, NodeEndpoint
from midstride.model.contract import Predicate, QoS
from midstride.runtime.process.registration import mismatches, unexpected_endpoints
from midstride.wire.state import Endpoint as ExtraEndpoint

RANGE = "sensor_msgs/msg/Range"
TWIST = "geometry_msgs/msg/Twist"


def controller(
    *,
    needed: float = 5,
    promised: float = 20,
    inputs: tuple[str, ...] = ("obstacles",),
    last: str = "stop",
    assumes: tuple[str, ...] | None = None,
    each: tuple[str, ...] = (),
) -> ComponentSpec:
    alternatives: list[tuple[str, ...]] = [(name,) for name in each] or [assumes or inputs[:1]]
    assumptions = tuple(map(InputAlternatives, alternatives))
    normal = Mode("normal", assumptions, Map(cmd=Predicate(TWIST, promised, QoS(depth=5))))
    return ComponentSpec.of(
        "Controller",
        inputs={name: Predicate(RANGE, needed) for name in inputs},
        outputs=("cmd",),
        functionalities=(FunctionalitySpec("control", (normal, Mode(last)), inputs, ("cmd",)),),
    )


def test_the_same_declaration_matches() -> None:
    assert mismatches(controller(), controller()) == []


def test_a_stronger_guarantee_and_a_weaker_assumption_match() -> None:
    assert mismatches(controller(needed=5, promised=20), controller(needed=2, promised=50)) == []


@pytest.mark.parametrize(
    ("registered", "words"),
    [
        (controller(needed=10), "input obstacles assumes sensor_msgs/msg/Range @ 10 Hz"),
        (controller(promised=10), "rate: 10 Hz is offered, at least 20 Hz is needed"),
        (controller(inputs=("obstacles", "more")), "the node has input more, which is not declared"),
        (controller(inputs=("other",)), "input obstacles is declared, but the node does not have it"),
        (controller(last="halt"), "has the modes normal, halt instead of normal, stop"),
        (replace(controller(), outputs=("cmd", "extra")), "the node has output extra, which is not declared"),
    ],
)
def test_what_breaks_the_declaration_is_named(registered: ComponentSpec, words: str) -> None:
    assert any(words in fault for fault in mismatches(controller(), registered))


def test_a_node_may_not_insist_on_one_of_declared_alternatives() -> None:
    either = controller(inputs=("left", "right"), assumes=("left", "right"))
    only_left = controller(inputs=("left", "right"), assumes=("left",))
    assert mismatches(only_left, either) == []
    assert mismatches(either, only_left) == ["control in mode normal assumes left, which is not declared"]


def test_a_node_may_assume_some_of_what_is_declared_and_nothing_else() -> None:
    both = controller(inputs=("left", "right"), each=("left", "right"))
    only_left = controller(inputs=("left", "right"), assumes=("left",))
    assert mismatches(both, both) == mismatches(both, only_left) == []
    assert mismatches(only_left, both) == ["control in mode normal assumes right, which is not declared"]


def test_endpoints_that_are_no_ports_must_be_allowed() -> None:
    component = replace(controller(), allows=(NodeEndpoint("service", "~/reset"),))
    endpoints = [ExtraEndpoint(kind="service", name="/robot/controller/reset"), ExtraEndpoint(kind="topic", name="/tf")]
    assert unexpected_endpoints(component, {"/robot/controller_2", "/robot/controller"}, endpoints) == ["topic /tf"]
    assert unexpected_endpoints(controller(), "controller", endpoints) == [
        "service /robot/controller/reset",
        "topic /tf",
    ]


def test_a_ros_action_is_allowed_as_it_is_written_in_the_specification() -> None:
    text = """
    system s
    component Dock {
      run "python3 dock.py"   allows "ROS action" ~/dock
      functionality dock { mode normal { } mode degraded { } }
    }
    """
    specification = load_text(text).require()
    endpoints = [ExtraEndpoint(kind="ROS action", name="/dock/dock"), ExtraEndpoint(kind="ROS action", name="/fold")]
    assert unexpected_endpoints(specification.components["Dock"], {"dock"}, endpoints) == ["ROS action /fold"]
