"""The JSON forms of parameters: values, alone and with whether they can be set in place.

JSON has no numbers that are not finite, and a text `nan` is another value than the number: so such a number is an
object, as in ``{"float": "nan"}``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, TypeAlias, cast

from immutables import Map

from midstride.codec.form import FiniteNumber, Form, field, finite
from midstride.model.component import ParameterSection, ParameterSpec, ParameterValue, canonical

NotFinite: TypeAlias = Literal["nan", "inf", "-inf"]
NotFiniteForm: TypeAlias = Annotated[
    dict[Literal["float"], NotFinite],
    field('an object with `float`: "nan", "inf" or "-inf"', "a number that is not finite", min_length=1),
]
_NUMBERS: Final[Mapping[str, float]] = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_NUMBER_FORMS: Final = [{"float": number} for number in _NUMBERS]

_KINDS = {bool: "booleans", int: "integers", float: "reals", str: "texts", dict: "reals"}
_OBJECT = {"type": "object"}
_LISTS = [
    {"type": "array", "items": items}
    for items in ({"type": "string"}, {"anyOf": [{"type": "number"}, _OBJECT]}, {"type": "boolean"})
]
_ONE_TYPE = {"allOf": [{"anyOf": [{"not": {"type": "array"}}, *_LISTS]}]}


def _wrong(value: object) -> str | None:
    """Return what is wrong with a value of the right JSON types: msgspec takes an object for one with ``float``."""
    members = value if isinstance(value, list) else [value]
    if any(isinstance(member, dict) and member not in _NUMBER_FORMS for member in members):
        return 'an object is expected to have `float`: "nan", "inf" or "-inf"'
    kinds = sorted({_KINDS[type(member)] for member in members})
    return f"the values of a list must be of one type, here are {' and '.join(kinds)}" if len(kinds) > 1 else None


PlainValue: TypeAlias = (
    bool | int | float | str | dict[Literal["float"], NotFinite]
    | list[bool | int | float | str | dict[Literal["float"], NotFinite]]
)  # fmt: skip
_MemberForm: TypeAlias = Annotated[
    bool | int | FiniteNumber | str | NotFiniteForm, field("a text, a number or a boolean")
]
ValueForm: TypeAlias = Annotated[
    bool | int | FiniteNumber | str | NotFiniteForm | list[_MemberForm],
    field(
        "a text, a number or a boolean",
        "the value of a parameter; a list is of one kind",
        help="1.0 is a real",
        check=_wrong,
        extra_json_schema=_ONE_TYPE,
    ),
]


def json_value(value: Any) -> Any:
    """The form of a parameter's value; of one that is a form already, the same."""
    if isinstance(value, list):
        return [json_value(member) for member in value]
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"}
    return value


def json_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """The forms of the values of parameters."""
    return {name: json_value(value) for name, value in values.items()}


def from_json(value: Any) -> Any:
    """The parameter's value of a form, which is not judged; of one that is a value already, the same."""
    if isinstance(value, list):
        return [from_json(member) for member in value]
    if isinstance(value, dict):
        return _NUMBERS.get(value.get("float", ""), value)
    return canonical(value)


def value_of(value: PlainValue) -> ParameterValue:
    """The value of a parameter. Raises ValueError where the form has none, as a number that no float can hold."""
    if (wrong := _wrong(value)) is not None:
        raise ValueError(wrong)
    for member in value if isinstance(value, list) else [value]:
        finite(member)
    return cast("ParameterValue", from_json(value))


def values_of(values: Mapping[str, PlainValue]) -> Map[str, ParameterValue]:
    """The values of parameters. Raises ValueError as :func:`value_of` does."""
    return Map({name: value_of(value) for name, value in values.items()})


def values_form(parameters: Mapping[str, ParameterValue]) -> dict[str, PlainValue]:
    """The values of parameters, sorted by name."""
    return {name: json_value(value) for name, value in sorted(parameters.items())}


class SectionForm(Form, frozen=True):
    """A section of a parameter file, for further nodes in a process."""

    what: ClassVar[str] = "a section of a parameter file"

    name: Annotated[str, field("the name of a section", "as rcl matches it to nodes", min_length=1)]
    parameters: Annotated[dict[str, ValueForm], field("an object of values", "its parameters")] = {}

    @classmethod
    def of(cls, section: ParameterSection) -> SectionForm:
        return cls(section.pattern, values_form(section.parameters))

    def section(self) -> ParameterSection:
        """Raises ValueError as :func:`value_of` does."""
        return ParameterSection(self.name, values_of(self.parameters))


SectionsForm: TypeAlias = Annotated[
    list[SectionForm], field("a list of sections", "parameters of further nodes in its process, as files order them")
]


class ParameterForm(Form, frozen=True):
    """A parameter's value, and whether it can be set in place."""

    what: ClassVar[str] = "a parameter"

    value: ValueForm
    changeable: bool = False

    @classmethod
    def of(cls, parameter: ParameterSpec) -> ParameterForm:
        return cls(value=json_value(parameter.value), changeable=parameter.changeable)

    def parameter(self) -> ParameterSpec:
        """Raises ValueError as :func:`value_of` does."""
        return ParameterSpec(value_of(self.value), self.changeable)
