"""Specifications as values, and what tells two components, connectors and configurations apart."""

from __future__ import annotations

from dataclasses import replace

import pytest
from immutables import Map

from midstride.codec.specification_form import decode_specification
from midstride.model.best import best
from midstride.model.component import (
    ComponentSpec,
    Connector,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    NodeEndpoint,
    ParameterSpec,
    PortRef,
)
from midstride.model.configuration import Instance, to_fraction
from midstride.model.diagnosis import reasons_against
from midstride.model.specification import Node, Order, initial, structure
from tests.model.build import at, component, filter_, mode, sink, source, system, work
from tests.model.test_wellformed import DEMO

SPECIFICATION = decode_specification(DEMO)


def test_a_system_starts_in_best_under_the_names_of_its_roles() -> None:
    configuration = initial(SPECIFICATION)
    assert configuration == best(structure(SPECIFICATION))
    assert sorted(configuration.instances) == ["listener", "talker"]
    assert set(configuration.modes.values()) == {0}
    assert configuration.attached_ports("talker") == [(PortRef("talker", "out"), "/chatter")]


def test_changes_share_the_world() -> None:
    other = SPECIFICATION.with_node(Node("third", "Talker", Map({"out": ("/chatter",)})))
    assert other.roles() == ["listener", "talker", "third"]
    assert other.context is SPECIFICATION.context
    assert other.without_node("third") == SPECIFICATION
    assert SPECIFICATION.with_replaced("talker", "Listener").component_of("talker").name == "Listener"
    with pytest.raises(KeyError):
        SPECIFICATION.with_replaced("talker", "Nobody")
    with pytest.raises(KeyError):
        SPECIFICATION.without_node("nobody")
    raised = replace(SPECIFICATION, environment=())
    assert raised.context == SPECIFICATION.context


def test_a_role_that_goes_takes_its_constraints_along() -> None:
    ordered = replace(SPECIFICATION, constraints=(Order("talker", "listener"),))
    assert ordered.without_node("listener").constraints == ()
    assert ordered.with_node(Node("third", "Talker")).constraints == ordered.constraints


def test_an_instance_has_a_value_for_every_parameter() -> None:
    tuned = component(
        "Tuned", {}, [], [mode("m"), mode("n")], parameters={"a": ParameterSpec(1), "b": ParameterSpec("x")}
    )
    assert dict(Instance("t", "t", tuned, Map({"a": 2})).parameters) == {"a": 2, "b": "x"}
    assert SPECIFICATION.instance("talker", "talker_2") == Instance(
        "talker_2", "talker", SPECIFICATION.components["Talker"], Map({"volume": 0.5})
    )


def test_a_component_is_its_body() -> None:
    talker = SPECIFICATION.components["Talker"]
    assert talker.same_body(replace(talker, name="Other", startup_seconds=3.0, parameters=Map()))
    for other in (
        replace(talker, run="python3 other.py"),
        replace(talker, resource_usage=Map({"gpu": 0.25})),
        replace(talker, allows=(NodeEndpoint("topic", "/tf"),)),
        source("Talker", 11.0),
    ):
        assert not talker.same_body(other)


def test_a_body_has_no_order_but_that_of_its_modes() -> None:
    left, right = at(5), at(10)
    merge = FunctionalitySpec("merge", (Mode("m", (InputAlternatives(("l", "r")), left)), Mode("d")), ("l", "r"))
    both = ComponentSpec.of("C", inputs={"l": left, "r": right}, functionalities=(merge,))
    turned = replace(merge, modes=(Mode("m", (left, InputAlternatives(("r", "l")))), Mode("d")), inputs=("r", "l"))
    assert both.same_body(ComponentSpec.of("C", inputs={"r": right, "l": left}, functionalities=(turned,)))
    for other in (
        replace(merge, modes=merge.modes[::-1]),
        replace(merge, modes=(Mode("m", (InputAlternatives(("l",)), left)), Mode("d"))),
        replace(merge, inputs=("l",)),
    ):
        assert not both.same_body(ComponentSpec.of("C", inputs={"l": left, "r": right}, functionalities=(other,)))


def test_a_topic_is_its_contract() -> None:
    connector = Connector("/t", at(5))
    assert connector.topic == "/t"
    assert connector.same_contract(Connector("/t#2", at(5), max_publishers=1, topic="/t"))
    assert not connector.same_contract(Connector("/t", at(6)))
    assert not connector.same_contract(Connector("/u", at(5)))


def test_references_are_written_with_a_dot() -> None:
    assert PortRef.parse("robot1/talker.out") == PortRef("robot1/talker", "out")
    assert str(FunctionalityRef("robot1/talker", "talk")) == "robot1/talker.talk"
    assert FunctionalityRef.parse("talker.talk") == FunctionalityRef("talker", "talk")


def test_amounts_are_exact() -> None:
    assert to_fraction(0.1) + to_fraction(0.2) == to_fraction(0.3)
    assert to_fraction(8192) == to_fraction(8192.0) == 8192


def test_reasons_in_a_cycle_end() -> None:
    needy = component("Needy", {"in": at(5), "key": at(5)}, ["out"], [mode("normal", [at(5)], out=at(5)), mode("off")])
    wiring = ["a.in /ba", "a.out /ab", "b.in /ab", "b.out /ba", "c.in /ab"]
    configuration = system({"a": filter_("A"), "b": filter_("B"), "c": sink("C")}, wiring)
    assert [reason.split()[0] for reason in reasons_against(configuration, work("c"))] == ["c.work", "a.work", "b.work"]
    assert "input needy.in is not attached" in reasons_against(system({"needy": needy}, []), work("needy"))[0]


def test_reasons_ask_no_more_of_a_helper_than_is_needed() -> None:
    """The middle mode of the source would do: so what its best mode lacks is not told."""
    chain = [mode("best", [at(99)], out=at(50)), mode("middle", out=at(10)), mode("off")]
    configuration = system({"s": component("S", {}, ["out"], chain), "sink": sink()}, ["s.out /t", "sink.in /t"])
    (only,) = reasons_against(configuration, work("sink"))
    assert "s.out in mode off: nothing is guaranteed" in only
    assert reasons_against(configuration, work("sink"), 1) == ()


def test_another_component_keeps_the_values_that_it_can_have() -> None:
    """Its own parameters, and those of every ROS node."""
    [name, *_] = sorted(SPECIFICATION.components)
    new = replace(SPECIFICATION.components[name], parameters=Map(gain=ParameterSpec(1.0)))
    node = replace(SPECIFICATION.nodes["talker"], parameters=Map(gain=2.0, width=3, use_sim_time=True))
    specification = replace(SPECIFICATION, components=SPECIFICATION.components.set(name, new))
    changed = specification.with_node(node).with_replaced("talker", name)
    assert changed.nodes["talker"] == replace(node, component=name, parameters=Map(gain=2.0, use_sim_time=True))
