"""The values of parameters in launch files, with the types that launch gives them.

They are read twice: by launch, as PyYAML reads plain values, and by ROS, which reads what launch has written. The first
is done here, as in ``launch.utilities.type_utils``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeAlias

from midstride.errors import NOT_OF_TAG
from midstride.launch_files.entity import Entity, EntityValue, Plain
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.substitutions import SubstitutionCall, Template, parse

Perform: TypeAlias = Callable[[Template], str]
# A value of a type that parameters may have, as launch hands it to PyYAML.
LaunchValue: TypeAlias = "Plain | list[Plain]"

MAX_TEXT: Final = 1_000_000
_SCALARS: Final = (int, float, bool, str)
_TYPES: Final[dict[str, tuple[type, bool] | None]] = {
    **{name: (kind, False) for name, kind in (("str", str), ("bool", bool), ("float", float), ("int", int))},
    **{
        f"list_of_{name}": (kind, True) for name, kind in (("str", str), ("bool", bool), ("float", float), ("int", int))
    },
    "yaml": None,
}


class _NotYaml(UnknownValue):
    """A value is not valid YAML."""


def plain(value: EntityValue) -> str:
    """The value of an attribute as text, as it would be in XML."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def value_of(entity: Entity, attribute: str, perform: Perform) -> LaunchValue:
    """The value of a parameter, with its substitutions carried out. Raises UnknownValue."""
    if attribute not in entity.attributes:
        raise UnknownValue(f"`{entity.tag}` has no `{attribute}`", "unsupported")
    stated = entity.attributes.get("type")
    wanted = None if stated is None else type_named(stated)
    value = entity.attributes[attribute]
    separator = entity.attributes.get(f"{attribute}-sep")
    if entity.typed:
        _require_instance(value, wanted)
    elif isinstance(value, str) and separator:
        value = _coerced_list(value.split(str(separator)), wanted)
    else:
        value = coerced(str(value), wanted, or_text=True)
    if not isinstance(value, list):
        return _performed(_parsed(value), wanted, perform)
    members = [_parsed(each) for each in value]
    if len({type(each) for each in members if not isinstance(each, tuple)}) > 1:
        raise _mixed()
    member_type = None if wanted is None else (wanted[0], False)
    if wanted is not None and not wanted[1]:
        raise UnknownValue(f"a list is not of the type `{stated}`", "parameters")
    done = [_performed(each, member_type, perform) for each in members]
    return _uniform(done)


def type_named(name: EntityValue) -> tuple[type, bool] | None:
    """The type of a value, and whether it is a list; None for any type. Raises UnknownValue."""
    if not isinstance(name, str) or name not in _TYPES:
        raise UnknownValue(f"`{name}` is not a type of parameters", "parameters")
    return _TYPES[name]


def value_of_text(text: str) -> LaunchValue:
    """The value of a parameter that is set for all nodes; its type is that of its text. Raises UnknownValue."""
    value = _yaml(text) if text else ""
    if isinstance(value, list):
        if not value:
            raise UnknownValue("an empty list has no type", "parameters")
        return _uniform(value)
    if type(value) not in _SCALARS:
        raise UnknownValue("the value is no text, number, boolean or list of them", "parameters")
    return value


def _parsed(value: Plain) -> Plain | Template:
    """Text without substitutions loses its escapes, and is read no further."""
    if not isinstance(value, str):
        return value
    template = parse(value)
    if any(isinstance(part, SubstitutionCall) for part in template):
        return template
    return "".join(str(part) for part in template)


def _performed(value: Plain | Template, wanted: tuple[type, bool] | None, perform: Perform) -> LaunchValue:
    if isinstance(value, tuple):
        return coerced(perform(value), wanted, or_text=False)
    if wanted is not None and (wanted[1] or not isinstance(value, wanted[0])):
        raise UnknownValue(f"`{plain(value)}` is not of the stated type", "parameters")
    return value


def coerced(text: str, wanted: tuple[type, bool] | None, *, or_text: bool) -> LaunchValue:
    """``text`` as a value of the wanted type, or of that which it has in YAML. ``or_text``: else it stays text."""
    if wanted is None:
        try:
            return _allowed(_yaml(text) if text else "", or_text)
        except _NotYaml:
            if or_text:
                return text
            raise
    kind, is_list = wanted
    valid = (str, kind) if or_text else (kind,)
    if is_list:
        found = _allowed(_yaml(text) if text else "", or_text)
        if not isinstance(found, list) or not all(isinstance(each, valid) for each in found):
            raise UnknownValue("the value is not of the stated type", "parameters")
        return found
    if kind is str:
        return text
    if kind is not bool:
        try:
            return kind(text)  # type: ignore[no-any-return]
        except (ValueError, OverflowError):
            if or_text:
                return text
            raise UnknownValue(f"`{text[:80]}` is not of the stated type", "parameters") from None
    found = _allowed(_yaml({"1": "true", "0": "false"}.get(text, text)) if text else "", or_text)
    if not isinstance(found, valid):
        raise UnknownValue(f"`{text[:80]}` is not of the stated type", "parameters")
    return found


def _coerced_list(texts: list[str], wanted: tuple[type, bool] | None) -> list[Plain]:
    if wanted is not None and not wanted[1]:
        raise UnknownValue("a list is not of the stated type", "parameters")
    kind = None if wanted is None else (wanted[0], False)
    members = [coerced(text, kind, or_text=True) for text in texts]
    found = _allowed(members, True)
    assert isinstance(found, list)
    return found


def _require_instance(value: Any, wanted: tuple[type, bool] | None) -> None:
    """Check the type of ``value``; text is allowed, as its substitutions may give another type."""
    if wanted is None:
        _allowed(value, True)
        return
    valid = (str, wanted[0])
    members = value if isinstance(value, list) else [value]
    if isinstance(value, list) is wanted[1] and all(isinstance(each, valid) for each in members):
        return
    raise UnknownValue("the value is not of the stated type", "parameters")


def _allowed(value: Any, or_text: bool) -> LaunchValue:
    """Raises UnknownValue for what a parameter cannot be. ``or_text``: a list may have text beside one other type."""
    if isinstance(value, list):
        other = next((type(each) for each in value if type(each) is not str), str)
        valid = (other, str) if or_text else (other,)
        if other not in _SCALARS or not all(isinstance(each, valid) for each in value):
            raise _mixed()
        return value
    if not isinstance(value, _SCALARS):
        raise UnknownValue("the value is no text, number, boolean or list of them", "parameters")
    return value


def _uniform(values: list[Any]) -> list[Plain]:
    kinds = {type(value) for value in values}
    if len(kinds) > 1 or not kinds <= set(_SCALARS):
        raise _mixed()
    return values


def _mixed() -> UnknownValue:
    return UnknownValue("a list mixes types, or has lists as its values", "parameters")


def _yaml(text: str) -> Any:
    """``text`` read as launch does. Raises UnknownValue."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    if len(text) > MAX_TEXT:
        raise UnknownValue("the value is too long", "parameters")
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, *NOT_OF_TAG):
        raise _NotYaml("the value is not valid YAML", "parameters") from None
