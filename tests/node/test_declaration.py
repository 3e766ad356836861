"""The author's API before start: what a declaration says, and every misuse with what to write instead."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from midstride import (
    Component,
    NodeError,
    QoS,
    any_of,
    approximate,
    at_least,
    at_most,
    between,
    guarantee,
)
from midstride.codec.component_form import decode_component, encode_component
from midstride.model.component import InputAlternatives
from midstride.model.contract import NOTHING, Interval, OneOf, Predicate
from midstride.node.author.declared_contracts import type_name
from midstride.node.author.declared_parameters import Parameter

from .author import Image, String


def nothing() -> None:
    pass


def one(message: object) -> None:
    pass


def two(left: object, right: object) -> None:
    pass


def test_the_papers_listing_declares_what_it_says() -> None:
    comp = Component("talker")
    out = comp.create_output("out", String)
    talk = comp.create_functionality("talk", outputs=[out])
    talk.set_normal_mode(nothing, rate=10, outputs=[out])
    talk.set_degraded_mode(nothing)
    declared = comp.declaration()
    assert declared.name == "talker" and declared.outputs == ("out",) and declared.input_order == ()
    functionality = declared.functionalities["talk"]
    assert [mode.name for mode in functionality.modes] == ["normal", "degraded"]
    assert functionality.modes[0].guarantee("out") == Predicate("std_msgs/String", 10)
    assert functionality.modes[1].guarantee("out") is NOTHING
    assert functionality.weight == 1


def test_an_alternative_is_shown_as_it_is_written() -> None:
    comp = Component("fusion")
    assert repr(any_of(comp.create_input("left", Image), comp.create_input("right", Image))) == "any_of(left, right)"


def test_a_whole_declaration() -> None:
    comp = Component("fusion")
    best_effort = QoS(reliability="best_effort", depth=3)
    fields = {"width": at_least(640), "height": between(480, 1080), "encoding": {"rgb8", "bgr8"}, "step": at_most(4096)}
    left = comp.create_input("left", Image, rate=15, qos=best_effort, where=fields)
    right = comp.create_input("right", Image, where={"header.frame_id": "base_link"})
    odom = comp.create_input("odom", String)
    out = comp.create_output("out", Image, qos=best_effort)
    health = comp.create_output("health", String, qos=5)
    fuse = comp.create_functionality("fuse", inputs=[left, right, odom], outputs=[out, health], weight=3)
    fuse.set_normal_mode(
        two,
        inputs=[left, right],
        outputs=[out, health],
        sync=approximate(0.05),
        guarantees={out: guarantee(15, {"width": 1280}), health: 1},
    )
    fuse.set_mode(
        "one_eyed",
        {left: one, right: one},
        inputs=[any_of(left, right), odom],
        outputs=[out, health],
        guarantees={out: guarantee(rate=10, where={"width": {640, 1280}}), health: 1},
    )
    fuse.set_degraded_mode(nothing, rate=1, outputs=[health], name="stop")
    comp.parameter("gain", 0.5, on_change=one)
    comp.parameter("frame", "base_link")
    declared = comp.declaration()
    assert declared.inputs["left"].rate == 15 and declared.inputs["left"].qos == best_effort
    assert dict(declared.inputs["left"].fields) == {
        "width": Interval(low=640),
        "height": Interval(480, 1080),
        "encoding": OneOf.of(["rgb8", "bgr8"]),
        "step": Interval(high=4096),
    }
    assert dict(declared.inputs["right"].fields) == {"header.frame_id": OneOf.of(["base_link"])}
    normal, one_eyed, stop = declared.functionalities["fuse"].modes
    assert normal.assumptions == (InputAlternatives(("left",)), InputAlternatives(("right",)))
    assert one_eyed.assumptions == (InputAlternatives(("left", "right")), InputAlternatives(("odom",)))
    assert stop.name == "stop" and stop.assumptions == ()
    assert one_eyed.guarantee("out") == Predicate(
        "sensor_msgs/Image", 10, best_effort, (("width", OneOf.of([640, 1280])),)
    )
    assert stop.guarantee("health") == Predicate("std_msgs/String", 1, QoS(depth=5))
    assert declared.output_endpoint("health") == ("std_msgs/msg/String", QoS(depth=5))
    assert declared.parameters["gain"].changeable and not declared.parameters["frame"].changeable
    assert decode_component(encode_component(declared)) == declared


def test_a_message_driven_mode_guarantees_no_rate_unless_it_states_one() -> None:
    comp = Component("relay")
    in_ = comp.create_input("in", String)
    out = comp.create_output("out", String)
    relay = comp.create_functionality("relay", inputs=[in_], outputs=[out])
    relay.set_normal_mode(one, inputs=[in_], outputs=[out])
    relay.set_degraded_mode(nothing)
    guaranteed = comp.declaration().functionalities["relay"].modes[0].guarantee("out")
    assert isinstance(guaranteed, Predicate) and guaranteed.rate is None


class Parts:
    """A component to misuse."""

    def __init__(self) -> None:
        self.comp = Component("camera")
        self.scan = self.comp.create_input("scan", String)
        self.odom = self.comp.create_input("odom", String)
        self.out = self.comp.create_output("out", String)
        self.imu = self.comp.create_input("imu", String)
        inputs = [self.scan, self.odom, self.imu]
        self.work = self.comp.create_functionality("work", inputs=inputs, outputs=[self.out])

    def normal(self, fn: Any = nothing, **options: Any) -> None:
        self.work.set_normal_mode(fn, **options)

    def declared(self) -> None:
        self.comp.declaration()


def degraded_twice(p: Parts) -> None:
    p.work.set_degraded_mode(nothing)
    p.work.set_degraded_mode(nothing)


def normal_twice(p: Parts) -> None:
    p.normal(rate=1)
    p.normal(rate=1)


def not_degraded(p: Parts) -> None:
    p.normal(rate=1)
    p.declared()


def not_normal(p: Parts) -> None:
    p.work.set_degraded_mode(nothing)
    p.declared()


def not_owned(p: Parts) -> None:
    p.comp.create_output("spare", String)
    p.normal(rate=1)
    p.work.set_degraded_mode(nothing)
    p.declared()


def better_guarantees_less(p: Parts) -> None:
    p.normal(rate=5, outputs=[p.out])
    p.work.set_degraded_mode(nothing, rate=10, outputs=[p.out])
    p.declared()


def better_guarantees_less_on_the_second(p: Parts) -> None:
    p.normal(rate=10)
    p.work.set_degraded_mode(nothing)
    outputs = [p.comp.create_output(name, String) for name in ("first", "second")]
    more = p.comp.create_functionality("more", outputs=outputs)
    more.set_normal_mode(nothing, rate=10, outputs=outputs, guarantees={outputs[1]: 5})
    more.set_degraded_mode(nothing, rate=10, outputs=outputs)
    p.declared()


def better_guarantees_nothing(p: Parts) -> None:
    p.normal(rate=5)
    p.work.set_degraded_mode(nothing, rate=1, outputs=[p.out])
    p.declared()


def same_mode_name(p: Parts) -> None:
    p.normal(rate=1)
    p.work.set_mode("normal", nothing, rate=1)


def foreign_output(p: Parts) -> None:
    other = Component("other").create_output("out", String)
    p.comp.create_functionality("more", outputs=[other])


def unknown_mode_input(p: Parts) -> None:
    lone = p.comp.create_functionality("lone")
    lone.set_normal_mode(one, inputs=[p.scan])


def unknown_mode_output(p: Parts) -> None:
    lone = p.comp.create_functionality("lone")
    lone.set_normal_mode(nothing, rate=1, outputs=[p.out])


MISUSES: list[tuple[Callable[[Parts], object], str]] = [
    (lambda p: Component("2nd"), "'2nd' is not a name"),
    (lambda p: Component(""), "not a name"),
    (lambda p: p.comp.create_input("scan", String), "port scan exists already"),
    (lambda p: p.comp.create_output("scan", String), "port scan exists already"),
    (lambda p: p.comp.create_output("a-b", String), "not a name"),
    (lambda p: p.comp.create_output("o", "std_msgs/String"), "from std_msgs.msg import String"),  # type: ignore[arg-type]
    (lambda p: p.comp.create_output("o", dict), "dict is not a ROS message class"),
    (lambda p: p.comp.create_input("i", String, rate=0), "rate=0 is not a rate"),
    (lambda p: p.comp.create_input("i", String, rate=-1), "positive number of Hz"),
    (lambda p: p.comp.create_input("i", String, rate=math.nan), "is not a rate"),
    (lambda p: p.comp.create_input("i", String, rate=True), "is not a rate"),
    (lambda p: p.comp.create_input("i", String, rate="10"), "is not a rate"),  # type: ignore[arg-type]
    (lambda p: p.comp.create_input("i", String, qos="best_effort"), "QoS(reliability="),  # type: ignore[arg-type]
    (lambda p: p.comp.create_input("i", String, qos=QoS(reliability="sure")), "'reliable' or 'best_effort'"),  # type: ignore[arg-type]
    (lambda p: p.comp.create_input("i", String, qos=QoS(deadline=0)), "deadline=0"),
    (
        lambda p: p.comp.create_input("i", Image, where={"widht": 640}),
        "no field 'widht'; its fields are header,",
    ),
    (lambda p: p.comp.create_input("i", Image, where={"header.stamp.hour": 1}), "header.stamp has no field 'hour'"),
    (lambda p: p.comp.create_input("i", Image, where={"width": (1, 2)}), "is not a set of values"),
    (lambda p: p.comp.create_input("i", Image, where={"width": set()}), "contains no value"),
    (lambda p: p.comp.create_input("i", Image, where={"width": between(2, 1)}), "contains no value"),
    (lambda p: p.comp.create_input("i", Image, where={"width": [None]}), "cannot be the value of a field"),
    (lambda p: p.comp.create_input("i", Image, where="width"), "must map fields to values"),  # type: ignore[arg-type]
    (lambda p: p.comp.create_functionality("work"), "work exists already"),
    (lambda p: p.comp.create_functionality("w", weight=0), "greater than 0"),
    (lambda p: p.comp.create_functionality("w", inputs=p.scan), "must be a list; write inputs=[scan]"),  # type: ignore[arg-type]
    (lambda p: p.comp.create_functionality("w", inputs=[p.out]), "write what create_input returned"),  # type: ignore[list-item]
    (lambda p: p.comp.create_functionality("w", inputs=[p.scan, p.scan]), "names a port twice"),
    (lambda p: p.comp.create_functionality("w", outputs=[p.out]), "already belongs to functionality work"),
    (foreign_output, "not a port of this component"),
    (lambda p: p.normal(rate=0), "rate=0 is not a rate"),
    (lambda p: p.normal(rate=math.inf), "is not a rate"),
    (lambda p: p.normal(fn=None), "None is not a function"),
    (lambda p: p.normal(fn=one, rate=1), "at its rate, without arguments"),
    (lambda p: p.normal(fn=nothing, inputs=[p.scan]), "with each message of its input"),
    (lambda p: p.normal(fn={p.scan: one}, rate=1), "a mapping goes with inputs"),
    (lambda p: p.normal(fn=two, inputs=[p.scan, p.odom]), "{scan: on_scan, odom: on_odom}"),
    (
        lambda p: p.normal(fn=one, inputs=[p.scan, p.odom], sync=approximate(0.1)),
        "one message of each input: (scan, odom)",
    ),
    (lambda p: p.normal(fn=one, inputs=[p.scan], sync=approximate(0.1)), "several inputs"),
    (
        lambda p: p.normal(fn=one, inputs=[any_of(p.scan, p.odom)], sync=approximate(0.1)),
        "any_of() cannot be used with it",
    ),
    (
        lambda p: p.normal(fn=two, inputs=[any_of(p.scan, p.odom), p.imu], sync=approximate(0.1)),
        "any_of() cannot be used with it",
    ),
    (lambda p: p.normal(rate=1, sync=approximate(0.1)), "without rate="),
    (lambda p: p.normal(fn=two, inputs=[p.scan, p.odom], sync=0.1), "sync=approximate(0.05)"),
    (lambda p: p.normal(fn={p.odom: one}, inputs=[p.scan]), "which inputs= does not name"),
    (lambda p: p.normal(fn={}, inputs=[p.scan]), "calls no function"),
    (lambda p: p.normal(fn={p.scan: nothing}, inputs=[p.scan]), "with each message"),
    (lambda p: p.normal(rate=1, inputs=p.scan), "must be a list; write inputs=[scan]"),
    (lambda p: p.normal(rate=1, inputs=["scan"]), "which is not an input"),
    (lambda p: p.normal(rate=1, outputs=[p.scan]), "which is not an output"),
    (lambda p: p.normal(rate=1, outputs=[p.out], guarantees={p.out: 0}), "is not a rate"),
    (lambda p: p.normal(rate=1, guarantees={p.out: 1}), "outputs= of the mode does not"),
    (lambda p: p.normal(rate=1, guarantees=5), "{out: 20}"),
    (lambda p: p.normal(rate=1, outputs=[p.out], guarantees={p.out: None}), "None states nothing, leave it out"),
    (lambda p: p.work.set_mode("2", nothing, rate=1), "not a name"),
    (lambda p: p.work.set_degraded_mode(nothing, inputs=[p.scan]), "may assume nothing"),
    (unknown_mode_input, "write create_functionality(…, inputs=[…, scan])"),
    (unknown_mode_output, "write create_functionality(…, outputs=[…, out])"),
    (normal_twice, "set_mode("),
    (degraded_twice, "set_mode("),
    (same_mode_name, "already has a mode normal"),
    (not_degraded, "write work.set_degraded_mode(fn)"),
    (not_normal, "write work.set_normal_mode(fn, …)"),
    (not_owned, "output spare belongs to no functionality"),
    (better_guarantees_less, "at least 10 Hz is needed"),
    (better_guarantees_less_on_the_second, "on output second"),
    (better_guarantees_nothing, "the better mode normal does not"),
    (lambda p: Component("empty").declaration(), "has no functionality"),
    (lambda p: any_of(p.scan), "at least two inputs"),
    (lambda p: any_of(p.scan, p.out), "is not an input"),  # type: ignore[arg-type]
    (lambda p: approximate(0), "a number of seconds greater than 0"),
    (lambda p: approximate(1, queue=0), "at least one message"),
    (lambda p: p.comp.parameter("midstride.mode", 1), "cannot be the name"),
    (lambda p: p.comp.parameter("p", None), "cannot be the value of a ROS parameter"),  # type: ignore[arg-type]
    (lambda p: p.comp.parameter("p", [1, "a"]), "cannot be the value of a ROS parameter"),  # type: ignore[arg-type]
    (lambda p: (p.comp.parameter("p", 1), p.comp.parameter("p", 1)), "parameter p exists already"),
    (lambda p: p.comp.on_stop(None), "on_stop(None): pass a function"),  # type: ignore[type-var]
    (lambda p: p.comp.on_stop(nothing, timeout=0), "on_stop(timeout=)"),
    (lambda p: p.comp.clock.stamp(String()), "clock.stamp(header.stamp)"),
    (lambda p: p.comp.clock.sleep(1), "async mode function"),
    (lambda p: p.out.write("hello"), "out.write(String(…))"),
]


@pytest.mark.parametrize(("misuse", "words"), MISUSES, ids=lambda value: value if isinstance(value, str) else "")
def test_misuse_says_what_to_write_instead(misuse: Callable[[Parts], object], words: str) -> None:
    with pytest.raises(NodeError) as raised:
        misuse(Parts())
    assert words in str(raised.value)


def test_a_refused_call_changes_nothing() -> None:
    parts = Parts()
    with pytest.raises(NodeError):
        parts.normal(rate=-1)
    parts.normal(rate=1)
    with pytest.raises(NodeError):
        parts.comp.create_functionality("more", outputs=[parts.out])
    parts.work.set_degraded_mode(nothing)
    assert parts.comp.declaration().functionality_order == ("work",)


def test_writing_without_an_attachment_just_counts() -> None:
    out = Component("talker").create_output("out", String)
    out.write(String(data="into the void"))
    assert out.unattached == 1 and not out.attached


def test_before_it_starts_an_input_has_heard_nothing() -> None:
    in_ = Component("listener").create_input("in", String)
    assert in_.latest is None and in_.age is None and not in_.attached


def test_parameters_stand_at_their_default() -> None:
    assert Component("c").parameter("p", 5).value == 5


def test_starting_without_any_ros_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = Parts()
    parts.normal(rate=1)
    parts.work.set_degraded_mode(nothing)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.delenv("MIDSTRIDE_BACKEND", raising=False)
    with pytest.raises(NodeError, match="source your ROS's setup file"):
        parts.comp.start()
    monkeypatch.setenv("MIDSTRIDE_BACKEND", "ros9")
    with pytest.raises(NodeError, match="ros2, ros1"):
        parts.comp.start()


@pytest.mark.parametrize("what", ["export", "import"])
def test_changes_alone_are_no_state(what: str) -> None:
    comp = Component("counter")
    count = comp.create_functionality("count")
    count.set_normal_mode(nothing)
    count.set_degraded_mode(nothing)
    getattr(comp, f"on_{what}_changes")(nothing)
    with pytest.raises(NodeError, match=rf"on_{what}_changes\(\) adds to what on_{what}_state\(\) {what}s"):
        comp.declaration()
    getattr(comp, f"on_{what}_state")(nothing)
    comp.declaration()


def test_a_component_that_is_attached_to_nothing_is_not_live() -> None:
    comp = Component("counter")
    assert not comp.is_live
    comp.create_output("out", String)
    assert not comp.is_live


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_parameter_may_be_set_to_a_value_that_is_not_finite(value: float) -> None:
    seen: list[object] = []
    speed, gains = Parameter("speed", 1.5, seen.append), Parameter("gains", [1.0, 2.0], seen.append)
    speed.change(value)
    gains.change([1.0, value])
    assert seen == [value, [1.0, value]]
    fixed = Parameter("fixed", value, None)
    fixed.change(float(str(value)))  # the same, also as another NaN
    with pytest.raises(NodeError, match="keeps the value"):
        fixed.change(1.0)


@pytest.mark.parametrize("module", ["chat_msgs.msg", "chat_msgs.msg._line", "chat_msgs.msg.detail._line"])
def test_a_message_class_is_known_by_the_package_whose_msg_module_it_is_from(module: str) -> None:
    assert type_name(type("Line", (), {"__module__": module})) == "chat_msgs/msg/Line"


@pytest.mark.parametrize("module", ["chat_msgs", "chat_msgs.srv", "chat.chat_msgs.msg"])
def test_any_other_class_is_no_message_class(module: str) -> None:
    with pytest.raises(NodeError, match="Line is not a ROS message class"):
        type_name(type("Line", (), {"__module__": module}))


@pytest.mark.parametrize(
    "name",
    ["on_setup", "on_export_state", "on_import_state", "on_export_changes", "on_import_changes", "on_stop"],
)
def test_a_function_that_is_registered_by_a_decorator_keeps_its_name(name: str) -> None:
    comp = Component("counter")

    def function(*arguments: object) -> bytes:
        return b""

    assert getattr(comp, name)(function) is function


def test_a_queue_of_one_message_is_enough_to_match_it() -> None:
    assert approximate(0.1, queue=1).queue == 1
