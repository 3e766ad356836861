"""Two readers of one class definition: msgspec, which stops at the first fault, and the one that finds them all."""

from __future__ import annotations

import copy
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import UNSET, UnsetType, inspect

from midstride.codec.component_form import NamedComponentForm, decode_component, encode_component
from midstride.codec.configuration_form import ConfigurationForm, decode_configuration
from midstride.codec.fault_finder import FaultFinder
from midstride.codec.form import Form, encode, field
from midstride.codec.reading import decode_form, parse_json
from midstride.codec.specification_form import SpecificationForm, TimingForm, encode_specification
from midstride.errors import SpecificationError
from midstride.model.specification import TIMING, Specification, initial
from tests.codec.test_schema import places
from tests.strategies.systems import components, specifications

STRANGE = [None, True, -1, 0, 0.5, float("nan"), float("inf"), 10**400, "", "x", "a/B\n", [], ["x", 1], {}, {"x": 1}]


def found_in(document: Any, form: Any = SpecificationForm) -> tuple[Any, list[str]]:
    finder = FaultFinder()
    value = finder.read(document, inspect.type_info(form), ())
    return value, [f"{problem.code} {problem.path}" for problem in finder.faults]


@given(specifications())
def test_both_read_what_is_written(specification: Specification) -> None:
    document = encode_specification(specification)
    assert found_in(document) == (msgspec.convert(document, SpecificationForm), [])
    assert SpecificationForm.of(specification) == msgspec.json.decode(
        msgspec.json.encode(SpecificationForm.of(specification)), type=SpecificationForm
    )


@given(specifications(most=2), st.data())
def test_both_refuse_or_neither_does(specification: Specification, data: st.DataObject) -> None:
    """msgspec with what the forms check when they become values of the model, on documents spoilt in any place."""
    document = copy.deepcopy(encode_specification(specification))
    path = data.draw(st.sampled_from(places(document)[1:]))
    holder = document
    for key in path[:-1]:
        holder = holder[key]
    if data.draw(st.booleans()) and isinstance(holder, dict):
        holder["a key"] = holder.pop(path[-1])
    else:
        holder[path[-1]] = data.draw(st.sampled_from(STRANGE))
    value, faults = found_in(document)
    try:
        msgspec.convert(document, SpecificationForm).specification()
    except (msgspec.ValidationError, ValueError):
        assert faults, document
    else:
        assert not faults, document
    value.specification()  # stand-ins and all, it can be built


class Circle(Form, frozen=True, tag_field="kind", tag="circle"):
    what: ClassVar[str] = "a shape"
    radius: Annotated[float, field("a radius", gt=0)]


class Square(Form, frozen=True, tag_field="kind", tag="square"):
    what: ClassVar[str] = "a shape"
    side: int | None


class Drawing(Form, frozen=True):
    what: ClassVar[str] = "a drawing"
    shapes: list[Circle | Square]
    pen: Literal["thin", "thick"] = "thin"
    scale: tuple[int, float] = (1, 1.0)
    title: Annotated[str, field("a title", max_length=5)] | UnsetType = UNSET
    visible: bool = True


@pytest.mark.parametrize(
    ("document", "faults"),
    [
        ({"shapes": [{"kind": "circle", "radius": 2}, {"kind": "square", "side": None}]}, []),
        ({"shapes": [{"kind": "circle", "radius": 0}]}, ["E004 /shapes/0/radius"]),
        ({"shapes": [{"kind": "circel", "radius": 1}, {"side": 1}, 7]},
         ["E005 /shapes/0/kind", "E003 /shapes/1", "E001 /shapes/2"]),
        ({"shapes": [{"kind": 7}, {"kind": "square", "side": "x", "radius": 1}]},
         ["E001 /shapes/0/kind", "E001 /shapes/1/side", "E002 /shapes/1/radius"]),
        ({"shapes": [], "scale": [1]}, ["E003 /scale/1"]),
        ({"shapes": [], "scale": [1, 2, 3]}, ["E002 /scale/2"]),
        ({"shapes": [], "scale": "x", "pen": "thik"}, ["E001 /scale", "E005 /pen"]),
        ({"shapes": [], "title": "too long", "visible": 1}, ["E001 /title", "E001 /visible"]),
        ({"shapes": {}, 7: 1}, ["E001 /", "E001 /shapes"]),
        (None, ["E001 /"]),
    ],
)  # fmt: skip
def test_every_kind_of_type(document: Any, faults: list[str]) -> None:
    _, found = found_in(document, Drawing)
    assert found == faults
    if faults:
        with pytest.raises(SpecificationError):
            decode_form(document, Drawing)
    else:
        assert encode(decode_form(document, Drawing)) == document


def test_json_text_is_read_with_its_faults() -> None:
    assert decode_form(parse_json('{"shapes": []}'), Drawing) == Drawing(shapes=[])
    with pytest.raises(SpecificationError, match="written twice"):
        decode_form(parse_json('{"shapes": [{"kind": "square", "side": 1, "side": 2}]}'), Drawing)
    with pytest.raises(SpecificationError, match="an object with shapes, pen"):
        decode_form(parse_json("[]"), Drawing)


def test_a_key_written_twice_is_found_at_any_depth_and_nowhere_else() -> None:
    document = parse_json('{"system": "s", "constraints": [{"order": "a", "order": "b", "before": "c"}]}')
    with pytest.raises(SpecificationError) as error:
        decode_form(document, SpecificationForm)
    assert [problem.path for problem in error.value.problems] == ["/constraints/0/order"]


def test_the_timing_form_has_every_kind_of_step() -> None:
    assert set(TimingForm.__struct_fields__) == set(TIMING)


@given(components())
def test_a_registered_component_comes_back(component: Any) -> None:
    form = NamedComponentForm.of(component)
    assert msgspec.json.decode(msgspec.json.encode(form), type=NamedComponentForm).checked() == component
    assert next(iter(encode_component(component))) == "name"


def test_a_registered_component_is_checked_as_well() -> None:
    form = msgspec.convert({"name": "a b", "outputs": ["out", "out"]}, NamedComponentForm)
    with pytest.raises(SpecificationError) as error:
        form.checked()
    assert [problem.code for problem in error.value.problems] == ["E006", "E007"]
    mixed = msgspec.convert({"name": "A", "parameters": {"p": {"value": [1, "x"]}}}, NamedComponentForm)
    with pytest.raises(SpecificationError, match="integers and texts"):
        mixed.checked()
    with pytest.raises(SpecificationError, match="/parameters/p/value: the values of a list"):
        decode_component(encode(mixed))


@pytest.mark.parametrize("value", [{"": "nan"}, {"float": "nan", "more": "nan"}, [1.0, {"": "inf"}]])
def test_an_object_that_is_no_number_is_refused_as_the_value_of_a_parameter(value: Any) -> None:
    document = {"name": "A", "parameters": {"p": {"value": value}}}
    with pytest.raises(SpecificationError, match=r"/parameters/p/value.*float"):
        decode_component(document)


def test_a_configuration_names_what_does_not_fit() -> None:
    document = encode(ConfigurationForm.of(initial(Specification("s"))))
    assert decode_configuration(document) == initial(Specification("s"))
    with pytest.raises(SpecificationError, match=r"/modes/talker\.talk: .*talker"):
        decode_configuration({**document, "modes": {"talker.talk": "normal"}})
    with pytest.raises(SpecificationError, match="/attachments/0/1: an attachment has 2 entries"):
        decode_configuration({**document, "attachments": [["talker.out"]]})
    with pytest.raises(SpecificationError, match="a configuration needs the key `instances`"):
        decode_configuration({"context": {"system": "world"}, "attachments": [], "modes": {}})
