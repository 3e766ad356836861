"""The largest numbers, the same in both forms of a specification; an error is at the number."""

from __future__ import annotations

import json
from typing import Any

import pytest

from midstride.lang import load_text
from midstride.lang.load import Loaded

STRING = "std_msgs/msg/String"

# A number of each kind in JSON and in Stride, ‹…› around it; `{}` is for a number of the base unit.
NUMBERS = [
    ({"topics": {"/t": {"type": STRING, "rate": None}}}, "topic /t : std_msgs/msg/String @ ‹{} Hz›"),
    (
        {"topics": {"/t": {"type": STRING, "qos": {"deadline_seconds": None}}}},
        "topic /t : std_msgs/msg/String qos(deadline = ‹{}› s)",
    ),
    (
        {"topics": {"/t": {"type": STRING, "qos": {"lifespan_seconds": None}}}},
        "topic /t : std_msgs/msg/String qos(lifespan = ‹{}› s)",
    ),
    (
        {"topics": {"/t": {"type": STRING, "where": {"width": {"<=": None}}}}},
        "topic /t : std_msgs/msg/String where width <= ‹{}›",
    ),
    (
        {"topics": {"/t": {"type": STRING, "where": {"width": {"in": [1, None]}}}}},
        "topic /t : std_msgs/msg/String where width in {{1, ‹{}›}}",
    ),
    ({"resources": {"gpu": {"capacity": None}}}, "resource gpu = ‹{}›"),
    ({"components": {"C": {"takes_seconds": None}}}, 'component C {{ run "c" takes ‹{} s› }}'),
    ({"components": {"C": {"holds": {"gpu": None}}}}, "component C {{ holds gpu ‹{}› }}"),
    (
        {"components": {"C": {"functionalities": {"f": {"weight": None}}}}},
        "component C {{ functionality f weight ‹{}› {{ }} }}",
    ),
    ({"constraints": [{"limit": "n.f", "below_baseline_seconds": None}]}, "limit n.f below baseline ‹{} s›"),
    ({"timing_seconds": {"create": None}}, "timing {{ create ‹{} s› }}"),
]
UNITS = [
    ("topic /t : std_msgs/msg/String @ ‹1e18 kHz›", "topic /t : std_msgs/msg/String @ ‹1e15 kHz›"),
    ("contract Unused = std_msgs/msg/String @ ‹1.1e15 kHz›", "contract Unused = std_msgs/msg/String @ ‹1e15 kHz›"),
    ("limit n.f below baseline ‹1e18 min›", "limit n.f below baseline ‹1e16 min›"),
]


# What the numbers are about: wrong names would keep the meaning from being checked.
SYSTEM = {
    "system": "s",
    "resources": {"gpu": {}},
    "components": {
        "C": {
            "functionalities": {"f": {"modes": {"a": {}, "b": {}}}},
            "parameters": {"p": {"value": 1}, "l": {"value": [1]}},
        }
    },
    "nodes": {"n": {"component": "C"}},
}


def merged(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    both = {key: merged(one[key], other[key]) for key in one.keys() & other.keys() if isinstance(one[key], dict)}
    return {**one, **other, **both}


def text_of(document: dict[str, Any], number: object) -> str:
    """A specification in JSON with ``document`` in it, and in that ``number`` in the place of None."""
    return json.dumps(merged(SYSTEM, document), indent=1).replace("null", str(number))


def out_of_range(loaded: Loaded, source: str) -> list[str]:
    """The texts at which a number is out of range, each with a help."""
    found = [diagnostic for diagnostic in loaded.diagnostics if diagnostic.code in {"E004", "E126"}]
    assert all(diagnostic.span is not None and diagnostic.help for diagnostic in found)
    return [source.splitlines()[d.position[0] - 1][d.position[1] - 1 :] for d in found]


def stride(text: str) -> list[str]:
    source = "system s\n" + text.replace("‹", "").replace("›", "")
    return out_of_range(load_text(source, "t.stride"), source)


@pytest.mark.parametrize(("document", "text"), NUMBERS)
def test_the_largest_number_is_the_same_in_both_forms(document: dict[str, Any], text: str) -> None:
    def in_json(number: float) -> list[str]:
        source = text_of(document, number)
        return out_of_range(load_text(source, "t.json"), source)

    assert in_json(1e18) == stride(text.format("1e18")) == []
    [at] = in_json(1.1e18)
    assert "1.1e+18" in at or at.startswith('"width"')
    [at] = stride(text.format("1.1e18"))
    assert at.startswith(("1.1e18", "gpu 1.1e18", "create 1.1e18", "width ")), at
    assert len(in_json(1e308)) == len(in_json(10**40)) == len(stride(text.format("1e308"))) == 1


@pytest.mark.parametrize(("above", "within"), UNITS)
def test_a_number_is_compared_in_its_base_unit(above: str, within: str) -> None:
    [at] = stride(above)
    assert at.startswith(above[above.index("‹") + 1 : above.index("›")])
    assert stride(within) == []


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "1" + 400 * "0", "1e309"])
@pytest.mark.parametrize(
    "document",
    [document for document, _ in NUMBERS]
    + [
        {"topics": {"/t": {"type": STRING, "max_publishers": None}}},
        {"topics": {"/t": {"type": STRING, "qos": {"depth": None}}}},
        {"components": {"C": {"parameters": {"p": {"value": None}}}}},
        {"components": {"C": {"parameters": {"l": {"value": [1.0, None]}}}}},
        {"nodes": {"n": {"component": "C", "parameters": {"p": None}}}},
    ],
)
def test_what_is_no_finite_number_is_an_error_at_its_place(document: dict[str, Any], number: str) -> None:
    source = text_of(document, number)
    loaded = load_text(source, "t.json")
    lines = [source.splitlines()[d.position[0] - 1] for d in loaded.diagnostics if d.code in {"E001", "E004"}]
    assert lines and all(number in line for line in lines), loaded.diagnostics


@pytest.mark.parametrize("number", [2**63, -(2**63) - 1])
@pytest.mark.parametrize(
    "document",
    [
        {"components": {"C": {"parameters": {"p": {"value": None}}}}},
        {"components": {"C": {"parameters": {"l": {"value": [1, None]}}}}},
        {"nodes": {"n": {"component": "C", "parameters": {"p": None}}}},
    ],
)
def test_an_integer_parameter_has_64_bits(document: dict[str, Any], number: int) -> None:
    def found(value: int) -> list[str]:
        source = text_of(document, value)
        return out_of_range(load_text(source, "t.json"), source)

    assert found(number - 1 if number > 0 else number + 1) == []
    [at] = found(number)
    assert at.startswith(('"p"', '"l"'))


def test_a_depth_has_31_bits() -> None:
    def found(depth: int) -> list[str]:
        source = text_of({"topics": {"/t": {"type": STRING, "qos": {"depth": None}}}}, depth)
        return out_of_range(load_text(source, "t.json"), source)

    assert found(2**31 - 1) == []
    assert found(2**31) == ['"depth": 2147483648']
