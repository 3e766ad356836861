"""The JSON forms of parameters: values, alone and with whether they can be set in place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, TypeAlias, cast

from immutables import Map

from midstride.codec.form import FiniteNumber, Form, ScalarForm, field, finite
from midstride.model.component import ParameterSpec, ParameterValue

_KINDS = {bool: "booleans", int: "integers", float: "reals", str: "texts"}
_LISTS = [{"type": "array", "items": {"type": kind}} for kind in ("string", "number", "boolean")]
_ONE_TYPE = {"allOf": [{"anyOf": [{"not": {"type": "array"}}, *_LISTS]}]}


def _mixed(value: object) -> str | None:
    kinds = sorted({_KINDS[type(member)] for member in value}) if isinstance(value, list) else []
    return f"the values of a list must be of one type, here are {' and '.join(kinds)}" if len(kinds) > 1 else None


PlainValue: TypeAlias = bool | int | float | str | list[bool | int | float | str]
ValueForm: TypeAlias = Annotated[
    bool | int | FiniteNumber | str | list[ScalarForm],
    field(
        "a text, a number or a boolean",
        "the value of a parameter; a list is of one kind",
        help="1.0 is a real",
        check=_mixed,
        extra_json_schema=_ONE_TYPE,
    ),
]


def value_of(value: PlainValue) -> ParameterValue:
    """The value of a parameter. Raises ValueError for a list of mixed types and for a number no float can hold."""
    for member in value if isinstance(value, list) else [value]:
        finite(member)
    if (wrong := _mixed(value)) is not None:
        raise ValueError(wrong)
    return cast("ParameterValue", value)


def values_of(values: Mapping[str, PlainValue]) -> Map[str, ParameterValue]:
    """The values of parameters. Raises ValueError as :func:`value_of` does."""
    return Map({name: value_of(value) for name, value in values.items()})


def values_form(parameters: Mapping[str, ParameterValue]) -> dict[str, PlainValue]:
    """The values of parameters, sorted by name."""
    return {name: cast("PlainValue", value) for name, value in sorted(parameters.items())}


class ParameterForm(Form, frozen=True):
    """A parameter's value, and whether it can be set in place."""

    what: ClassVar[str] = "a parameter"

    value: ValueForm
    changeable: bool = False

    @classmethod
    def of(cls, parameter: ParameterSpec) -> ParameterForm:
        return cls(value=cast("PlainValue", parameter.value), changeable=parameter.changeable)

    def parameter(self) -> ParameterSpec:
        """Raises ValueError as :func:`value_of` does."""
        return ParameterSpec(value_of(self.value), self.changeable)
