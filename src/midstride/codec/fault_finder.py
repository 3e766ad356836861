"""Every fault in a document, by the type information of the form that it should have.

What is faulty is replaced by a stand-in that keeps its names, so that one fault makes no others and the names in the
rest can be checked as well.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any, Final

from msgspec import inspect

from midstride.codec.form import Form, ShapedForm
from midstride.model.diagnostics import Problem, SubjectPath, suggestion


class RepeatedKeys(dict[str, Any]):
    """An object read from text in which keys are written twice, or one that holds such an object."""

    repeated: tuple[str, ...] = ()


def shown(value: object) -> str:
    """The kind of a JSON value, with the value where it is short."""
    if value is None:
        return "null"
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, (list, tuple)):
        return "a list"
    if not isinstance(value, (bool, int, float, str)):
        return type(value).__name__
    name = "a boolean" if isinstance(value, bool) else "a text" if isinstance(value, str) else "a number"
    text = json.dumps(value) if not isinstance(value, int) or abs(value) < 10**20 else ""
    return f"{name} ({text})" if 0 < len(text) <= 40 else name


class FaultFinder:
    """Reads a document by the type information of a form. Never raises: ``faults`` has all that is wrong."""

    def __init__(self) -> None:
        self.faults: list[Problem] = []

    def read(self, value: Any, type_: inspect.Type, path: SubjectPath, what: str = "", help: str = "") -> Any:
        """The value in the form of ``type_``, or a stand-in for it. ``what`` says in messages what it should be."""
        if isinstance(type_, inspect.Metadata):
            return self._described(value, type_, path, what, help)
        if isinstance(type_, inspect.StructType):
            return self._struct(value, type_, path)
        if isinstance(type_, inspect.DictType):
            return self._entries(value, type_, path, what or "an object")
        if isinstance(type_, inspect.ListType):
            return self._items(value, type_, path, what or "a list")
        if isinstance(type_, inspect.TupleType):
            return self._tuple(value, type_, path, what or "a list")
        if isinstance(type_, inspect.UnionType):
            return self._union(value, type_, path, what, help)
        if isinstance(type_, inspect.LiteralType):
            return self._word(value, type_, path)
        if isinstance(type_, inspect.StrType):
            return self._text(value, type_, path, what or "a text", help)
        if isinstance(type_, (inspect.IntType, inspect.FloatType)):
            return self._number(value, type_, path, what)
        if isinstance(type_, inspect.BoolType) and not isinstance(value, bool):
            return self._expected(value, type_, path, what or "true or false")
        return value

    def _fault(self, code: str, path: SubjectPath, message: str, help: str = "") -> None:
        self.faults.append(Problem(code, path, message, help))

    def _expected(self, value: object, type_: inspect.Type, path: SubjectPath, what: str, help: str = "") -> Any:
        self._fault("E001", path, f"{what} is expected, this is {shown(value)}", help)
        return stand_in(type_)

    def _described(self, value: Any, type_: inspect.Metadata, path: SubjectPath, what: str, help: str) -> Any:
        extra = type_.extra or {}
        before = len(self.faults)
        found = self.read(value, type_.type, path, extra.get("what") or what, extra.get("help") or help)
        check = extra.get("check")
        if check is None or (wrong := check(found)) is None:
            return found
        if len(self.faults) == before:  # else a stand-in may cause it
            self._fault("E001", path, wrong, extra["help"])
        return stand_in(type_)

    # -- objects and lists -------------------------------------------------------------------------------------

    def _keys(self, value: dict[Any, Any], path: SubjectPath) -> dict[str, Any]:
        """The entries whose keys are texts; keys that are none, or written twice, are faults."""
        for key in getattr(value, "repeated", ()):
            self._fault("E007", (*path, key), f"`{key}` is written twice", "JSON would keep the last one alone")
        for key in value:
            if not isinstance(key, str):
                self._fault("E001", path, f"the key {key!r} is not a text")
        return {key: entry for key, entry in value.items() if isinstance(key, str)}

    def _struct(self, value: Any, type_: inspect.StructType, path: SubjectPath) -> Any:
        form = type_.cls
        what: str = getattr(form, "what", Form.what)
        fields = {field.encode_name: field for field in type_.fields}
        required = [name for name, field in fields.items() if field.required]
        if not isinstance(value, dict):
            help = "" if issubclass(form, ShapedForm) else f"an object with {', '.join(fields)}"
            return self._expected(value, type_, path, what, help)
        entries = self._keys(value, path)
        if type_.tag_field is not None:
            entries.pop(type_.tag_field, None)
        if issubclass(form, ShapedForm):
            telling = {shape.required[0]: shape for shape in form.shapes}
            shape = next((telling[key] for key in entries if key in telling), form.otherwise)
            if shape is None:
                near = suggestion(next(iter(entries)), telling) if entries else ""
                self._fault("E001", path, f"{what} is expected", near)
                return stand_in(type_)
            what, required = shape.what, list(shape.required)
            fields = {name: fields[name] for name in (*shape.required, *shape.optional)}
        read: dict[str, Any] = {}
        for key, entry in entries.items():
            if key in fields:
                read[fields[key].name] = self.read(entry, fields[key].type, (*path, key))
            elif type_.forbid_unknown_fields:
                self._fault("E002", (*path, key), f"{what} has no key `{key}`", suggestion(key, fields))
        for key in required:
            if key not in entries:
                self._fault("E003", path, f"{what} needs the key `{key}`")
                read[fields[key].name] = stand_in(fields[key].type)
        return form(**read)

    def _entries(self, value: Any, type_: inspect.DictType, path: SubjectPath, what: str) -> Any:
        if not isinstance(value, dict):
            return self._expected(value, type_, path, what)
        found = {}
        for key, entry in self._keys(value, path).items():
            self.read(key, type_.key_type, (*path, key))
            found[key] = self.read(entry, type_.value_type, (*path, key))
        return found

    def _items(self, value: Any, type_: inspect.ListType, path: SubjectPath, what: str) -> Any:
        if not isinstance(value, (list, tuple)):
            return self._expected(value, type_, path, what, "write [ … ]")
        if type_.min_length is not None and len(value) < type_.min_length:
            self._fault("E001", path, f"{what} are expected, this is an empty list")
            return []
        return [self.read(item, type_.item_type, (*path, str(index))) for index, item in enumerate(value)]

    def _tuple(self, value: Any, type_: inspect.TupleType, path: SubjectPath, what: str) -> Any:
        if not isinstance(value, (list, tuple)):
            return self._expected(value, type_, path, what, "write [ … ]")
        types = type_.item_types
        for index in range(len(value), len(types)):
            self._fault("E003", (*path, str(index)), f"{what} has {len(types)} entries, this one is missing")
        for index in range(len(types), len(value)):
            self._fault("E002", (*path, str(index)), f"{what} has {len(types)} entries, this one is too many")
        items = zip(value, types, strict=False)
        found = [self.read(item, item_type, (*path, str(index))) for index, (item, item_type) in enumerate(items)]
        return tuple(found + [stand_in(missing) for missing in types[len(value) :]])

    def _union(self, value: Any, type_: inspect.UnionType, path: SubjectPath, what: str, help: str) -> Any:
        matching = [member for member in type_.types if _may_be(value, _bare(member))]
        tagged = [member for member in matching if isinstance(bare := _bare(member), inspect.StructType) and bare.tag]
        if tagged:
            return self._tagged(value, tagged, path)
        if not matching:
            others = [member for member in type_.types if not isinstance(member, inspect.NoneType)]
            if len(others) == 1:
                return self.read(value, others[0], path, what, help)
            structs = (bare.cls for bare in map(_bare, others) if isinstance(bare, inspect.StructType))
            named = getattr(next(structs, None), "what", "another value")
            return self._expected(value, type_, path, what or named, help)
        return self.read(value, matching[0], path, what, help)

    def _tagged(self, value: dict[Any, Any], members: Sequence[inspect.Type], path: SubjectPath) -> Any:
        """One of several structs, distinguished by the value of a key."""
        by_tag = {str(bare.tag): bare for member in members if isinstance(bare := _bare(member), inspect.StructType)}
        first = next(iter(by_tag.values()))
        key = str(first.tag_field)
        what: str = getattr(first.cls, "what", Form.what)
        if key not in value:
            self._fault("E003", path, f"{what} needs the key `{key}`")
            return stand_in(first)
        tag = value[key]
        if not isinstance(tag, str) or tag not in by_tag:
            words = ", ".join(by_tag)
            if isinstance(tag, str):
                self._fault("E005", (*path, key), f"`{tag}` is not one of {words}", suggestion(tag, by_tag))
            else:
                self._fault("E001", (*path, key), f"one of {words} is expected, this is {shown(tag)}")
            return stand_in(first)
        return self._struct(value, by_tag[tag], path)

    # -- values ------------------------------------------------------------------------------------------------

    def _text(self, value: Any, type_: inspect.StrType, path: SubjectPath, what: str, help: str) -> Any:
        if not isinstance(value, str):
            return self._expected(value, type_, path, what, help)
        if type_.min_length and not value:
            self._fault("E006", path, f"{what} cannot be empty")
        elif type_.pattern is not None and re.fullmatch(type_.pattern, value) is None:
            self._fault("E006", path, f"`{value}` is not {what}", help)
            return ""
        elif type_.max_length is not None and len(value) > type_.max_length:
            self._fault("E001", path, f"{what} of at most {type_.max_length} characters is expected")
        return value

    def _word(self, value: Any, type_: inspect.LiteralType, path: SubjectPath) -> Any:
        words = ", ".join(map(str, type_.values))
        if not isinstance(value, str):
            return self._expected(value, type_, path, f"one of {words}")
        if value not in type_.values:
            self._fault("E005", path, f"`{value}` is not one of {words}", suggestion(value, map(str, type_.values)))
            return type_.values[0]
        return value

    def _number(self, value: Any, type_: inspect.IntType | inspect.FloatType, path: SubjectPath, what: str) -> Any:
        whole = isinstance(type_, inspect.IntType)
        what = what or "a number"
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            return self._expected(value, type_, path, f"{what} (a whole number)" if whole else what)
        try:
            is_finite = math.isfinite(float(value))
        except OverflowError:
            is_finite = False
        if not is_finite:
            shown_value = "an integer of that size" if isinstance(value, int) else value
            self._fault("E004", path, f"{what} is expected, {shown_value} is none")
            return stand_in(type_)
        if (type_.gt is not None and value <= type_.gt) or (type_.ge is not None and value < type_.ge):
            bound = f"more than {type_.gt}" if type_.gt is not None else f"at least {type_.ge}"
            self._fault("E004", path, f"{what} must be {bound}, it is {value}")
            return stand_in(type_)
        return value if whole else float(value)


def stand_in(type_: inspect.Type) -> Any:
    """A value in the place of one that could not be read: empty, and with nothing in it that could be at fault."""
    if isinstance(type_, inspect.Metadata):
        return stand_in(type_.type)
    if isinstance(type_, inspect.UnionType):
        return None if any(isinstance(member, inspect.NoneType) for member in type_.types) else stand_in(type_.types[0])
    if isinstance(type_, inspect.StructType):
        shapes = type_.cls.shapes if issubclass(type_.cls, ShapedForm) else ()
        needed = shapes[0].required if shapes else ()
        fields = [field for field in type_.fields if field.required or field.encode_name in needed]
        return type_.cls(**{field.name: stand_in(field.type) for field in fields})
    if isinstance(type_, inspect.TupleType):
        return tuple(stand_in(item) for item in type_.item_types)
    if isinstance(type_, inspect.LiteralType):
        return type_.values[0]
    if isinstance(type_, inspect.IntType):
        return 1
    if isinstance(type_, inspect.FloatType):
        return 1.0
    if isinstance(type_, inspect.BoolType):
        return False
    if isinstance(type_, inspect.DictType):
        return {}
    return [] if isinstance(type_, inspect.ListType) else ""


def _bare(type_: inspect.Type) -> inspect.Type:
    return _bare(type_.type) if isinstance(type_, inspect.Metadata) else type_


# The types that a kind of JSON value may be of. A boolean is an int for Python, so it comes first.
_TYPES: Final[dict[type, tuple[type[inspect.Type], ...]]] = {
    type(None): (inspect.NoneType,),
    bool: (inspect.BoolType,),
    int: (inspect.IntType, inspect.FloatType),
    float: (inspect.FloatType,),
    str: (inspect.StrType, inspect.LiteralType),
    list: (inspect.ListType, inspect.TupleType),
    tuple: (inspect.ListType, inspect.TupleType),
    dict: (inspect.StructType, inspect.DictType),
}


def _may_be(value: object, type_: inspect.Type) -> bool:
    """Return whether the value is of the kind of JSON value that the type is."""
    return isinstance(type_, next((types for kind, types in _TYPES.items() if isinstance(value, kind)), ()))
