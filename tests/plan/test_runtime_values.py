"""Parameter values that were set at run time: which of them travel, and which give way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.component import ComponentSpec, Gate, ParameterSpec, ParameterValue
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.runtime_values import Values, decide, of_change, runtime_value, time_of, with_times
from tests.model import build


def component(name: str, run: str = "python3 node.py", **parameters: ParameterValue) -> ComponentSpec:
    declared = Map({key: ParameterSpec(value, changeable=True) for key, value in parameters.items()})
    return replace(build.source(name), run=run, parameters=declared)


def system(of: str, *components: ComponentSpec, **stated: ParameterValue) -> Specification:
    """One node, a ``Talker`` or another, with the values ``stated`` for it."""
    return Specification(
        "bench",
        components=Map({each.name: each for each in components}),
        nodes=Map({"talker": Node("talker", of, parameters=Map(stated))}),
    )


TALKER = component("Talker", gain=1.5, label="plain")
RUNNING = system("Talker", TALKER)


def fates(before: Specification, after: Specification, keep: bool = True, **values: Any) -> dict[str, str]:
    return {each.parameter: each.fate for each in decide(before, after, "talker", values, keep=keep)}


def test_values_travel_to_a_new_instance_of_the_same_component() -> None:
    (gain, label) = decide(RUNNING, RUNNING, "talker", {"label": "left", "gain": 1.7})
    assert (gain.node, gain.parameter, gain.value, gain.fate) == ("talker", "gain", 1.7, "kept")
    assert gain.words == "talker: gain = 1.7, set at run time: kept"
    assert (label.value, label.fate) == ("left", "kept")


def test_a_value_that_is_declared_again_is_not_listed() -> None:
    assert fates(RUNNING, system("Talker", TALKER, gain=1.7), gain=1.7) == {}
    assert fates(RUNNING, RUNNING, gain=1.5) == {}


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(system("Talker", TALKER, gain=2.0), id="the node states it"),
        pytest.param(system("Talker", component("Talker", gain=2.0, label="plain")), id="the component's default"),
        pytest.param(system("New", component("New", gain=1.0), gain=2.0), id="the node, with another component"),
    ],
)
def test_where_the_file_changed_the_value_as_well_the_file_wins(target: Specification) -> None:
    (gain,) = decide(RUNNING, target, "talker", {"gain": 1.7})
    assert gain.fate == "file_wins"
    assert gain.words == "talker: gain = 1.7, set at run time: the file wins and changes it to 2.0"


def test_another_default_of_another_component_is_no_change_of_the_value() -> None:
    assert fates(RUNNING, system("New", component("New", gain=2.0)), gain=1.7) == {"gain": "kept"}
    stated = system("Talker", TALKER, gain=3.0)
    assert fates(stated, system("New", component("New", gain=2.0), gain=3.0), gain=1.7) == {"gain": "kept"}


def test_what_the_new_component_does_not_declare_is_left_behind() -> None:
    (label,) = decide(RUNNING, system("New", component("New", gain=1.5)), "talker", {"label": "left"})
    assert (label.fate, label.words) == (
        "left_behind",
        "talker: label = 'left', set at run time: not declared by New, left behind",
    )


def test_a_parameter_that_only_the_program_declares_travels_if_the_new_one_does_too() -> None:
    (hidden,) = decide(RUNNING, RUNNING, "talker", {"hidden": 3})
    assert (hidden.fate, hidden.words) == (
        "kept",
        "talker: hidden = 3, set at run time: kept if the program of Talker declares it",
    )


@pytest.mark.parametrize(("value", "new"), [(1.7, "loud"), (1.7, 3), (True, 3), ([1], 1.5), ("x", [1.0])])
def test_a_value_of_another_type_is_refused_with_the_reason(value: ParameterValue, new: ParameterValue) -> None:
    target = system("New", component("New", gain=new))
    with pytest.raises(PlanRefused, match=r"talker has gain = .*, set at run time, and New takes a.*--declared-param"):
        decide(RUNNING, target, "talker", {"gain": value})
    assert fates(RUNNING, target, keep=False, gain=value) == {"gain": "not_kept"}


def test_the_clock_that_every_node_has_travels_unless_the_file_changed_it() -> None:
    (clock,) = decide(RUNNING, RUNNING, "talker", {"use_sim_time": True})
    assert (clock.fate, clock.words) == ("kept", "talker: use_sim_time = True, set at run time: kept")
    stated = system("Talker", TALKER, use_sim_time=True)
    assert fates(stated, stated, use_sim_time=False) == {"use_sim_time": "kept"}
    assert fates(RUNNING, stated, use_sim_time=True) == {}
    again = system("Talker", TALKER, use_sim_time=False)
    assert fates(stated, again, use_sim_time=False) == {}


def test_an_integer_fits_a_float() -> None:
    assert fates(RUNNING, RUNNING, gain=3) == {"gain": "kept"}


def test_declared_parameters_keep_nothing() -> None:
    gain, hidden = decide(RUNNING, RUNNING, "talker", {"gain": 1.7, "hidden": 3}, keep=False)
    assert (gain.fate, hidden.fate) == ("not_kept", "not_kept")
    assert gain.words == "talker: gain = 1.7, set at run time: not kept, as requested; it becomes 1.5"


def test_only_what_a_change_concerns_is_listed() -> None:
    values: dict[str, Values] = {"talker": {"gain": 1.7, "label": "left"}, "gone": {"gain": 1.0}}
    nothing = change_between(initial(RUNNING), RUNNING, RUNNING)
    assert of_change(nothing, values) == ()
    in_place = change_between(initial(RUNNING), RUNNING, target := system("Talker", TALKER, gain=2.0))
    assert [(each.parameter, each.fate) for each in of_change(in_place, values)] == [("gain", "file_wins")]
    renewed = change_between(initial(RUNNING), RUNNING, target, renewed=["talker"])
    assert [(each.parameter, each.fate) for each in of_change(renewed, values)] == [
        ("gain", "file_wins"),
        ("label", "kept"),
    ]


def test_a_program_without_the_api_starts_with_what_was_set_on_its_predecessor() -> None:
    """Also with what it does not declare in the specification: it may declare that itself."""
    gates: tuple[Gate, ...] = ("relay", "preload", "none", "lifecycle", "lifecycle preload")
    for gate in gates:
        target = system("New", replace(component("New", gain=1.0), gate=gate))
        assert fates(RUNNING, target, gain=1.7, own=3) == {"gain": "kept", "own": "kept"}


def test_a_value_says_when_a_request_has_set_it() -> None:
    values = [
        runtime_value("talker", "gain", 2.5, "kept", "kept"),
        runtime_value("talker", "own", 1.0, "kept", "kept", "node"),
        runtime_value("listener", "gain", 3.5, "kept", "kept"),
    ]
    times = {"talker": {"gain": 1.75e9, "own": 1.75e9}}
    first, *others = with_times(values, lambda role: times.get(role, {}))
    assert first.set_at == 1.75e9
    assert first.words == f"{values[0].words} (a request has set it at {time_of(1.75e9)})"
    assert others == values[1:]
    assert with_times([first], lambda _: {"gain": 1.0}) == (first,)
