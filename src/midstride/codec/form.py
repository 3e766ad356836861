"""The parts of every JSON form: base classes, constrained numbers and texts, and the wording of faults in them.

A form is a class that mirrors one kind of JSON object key by key; msgspec reads and writes it and derives its JSON
Schema. Its docstring and the descriptions of its fields are published in the schema.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, NamedTuple, TypeAlias

import msgspec
from msgspec import UNSET, Meta

Document: TypeAlias = dict[str, Any]


class Form(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A JSON object. What is the default is left out when it is written, an unknown key is a fault when it is read.

    ``what`` names it in messages: ``"a node"``. A form that writes all its fields sets ``omit_defaults=False``;
    a field that is UNSET is always left out.
    """

    what: ClassVar[str] = "an object"


class Report(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """An answer of the manager: every field is written, null where nothing is known, and unknown ones are ignored."""


class Shape(NamedTuple):
    """One of the sets of keys that an object may have."""

    what: str
    required: tuple[str, ...]
    optional: tuple[str, ...] = ()


class ShapedForm(Form, frozen=True):
    """An object whose keys are those of one of several shapes, which the first key of each distinguishes.

    Without any of these keys it has the shape ``otherwise``. Every field is optional, and UNSET where its shape does
    not have it.
    """

    shapes: ClassVar[tuple[Shape, ...]] = ()
    otherwise: ClassVar[Shape | None] = None

    @classmethod
    def all_shapes(cls) -> tuple[Shape, ...]:
        return cls.shapes if cls.otherwise is None else (*cls.shapes, cls.otherwise)

    def __post_init__(self) -> None:
        keys = zip(self.__struct_fields__, self.__struct_encode_fields__, strict=True)
        stated = {key for name, key in keys if getattr(self, name) is not UNSET}
        if not any({*shape.required} <= stated <= {*shape.required, *shape.optional} for shape in self.all_shapes()):
            raise ValueError(f"{self.what} is expected")


FormCheck: TypeAlias = Callable[[Any], "str | None"]


def field(
    what: str, description: str | None = None, *, help: str = "", check: FormCheck | None = None, **constraints: Any
) -> Meta:
    """The constraints on a value, and the words for what it is, in a message that misses it and in the schema.

    ``check`` says in words what is wrong with a value that has the right type, or None. It must also raise ValueError
    or reject when the form becomes a value of the model, since msgspec does not call it.
    """
    extra = {"what": what, "help": help, "check": check}
    return Meta(description=description, extra=extra, **constraints)


# Python's ``$`` accepts a line break after it.
END = r"(?!\n)$"

# msgspec takes infinity for a number unless it is bounded. The schema leaves this bound out.
LARGEST = sys.float_info.max

FiniteNumber: TypeAlias = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
ScalarForm: TypeAlias = Annotated[bool | int | FiniteNumber | str, field("a text, a number or a boolean")]
PositiveSeconds: TypeAlias = Annotated[float, field("a number of seconds", gt=0, le=LARGEST)]
SecondsOrZero: TypeAlias = Annotated[float, field("a number of seconds", ge=0, le=LARGEST)]


def plain(number: float) -> int | float:
    """A whole number without its ``.0``."""
    return int(number) if abs(number) < 2**53 and number == int(number) else number


def stated(value: Any) -> Any:
    """The written form of a value that may not be stated, a whole number without its ``.0``."""
    if value is None:
        return UNSET
    return plain(value) if isinstance(value, float) else value


def given(value: Any) -> Any:
    """The value of an optional field; None where it is left out."""
    return None if value is UNSET else value


def finite(value: Any) -> Any:
    """The value. Raises ValueError for a number that no float can hold: JSON's integers are not bounded."""
    try:
        if isinstance(value, (int, float)) and not math.isfinite(float(value)):
            raise ValueError(f"{value} is not a number")
    except OverflowError as error:
        raise ValueError(str(error)) from None
    return value


TOKEN = "[A-Za-z_][A-Za-z0-9_]*"


def named(pattern: str = TOKEN) -> dict[str, Any]:
    """The entry in the schema for a name that something is declared by.

    The schema alone: what may be a name is judged by :mod:`midstride.model.name_checks`, wherever it is written.
    """
    return {"pattern": f"^{pattern}$", "maxLength": 255}


def by_name(what: str, description: str, pattern: str = TOKEN) -> Meta:
    """The field for an object whose keys are the names that its entries are declared by."""
    return field(what, description, extra_json_schema={"propertyNames": named(pattern)})


NonEmptyName: TypeAlias = Annotated[str, Meta(min_length=1)]
HostName: TypeAlias = Annotated[
    str, field("the name of a host", "the host that it runs on; empty: that of the manager")
]


def encode(form: msgspec.Struct) -> Document:
    """The form as plain dicts and lists."""
    document: Document = msgspec.to_builtins(form)
    return document
