"""The values of parameters in launch files: their types are those of YAML, unless they are stated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias, cast

from midstride.lang.source import Source
from midstride.lang.yaml_tree import InvalidYaml, read_tree
from midstride.launch_files.entity import Entity, EntityValue, Plain
from midstride.launch_files.findings import UnknownValue
from midstride.model.component import ParameterValue, canonical

Substitute: TypeAlias = Callable[[str], str]
_TYPES: Final[dict[str, type]] = {"str": str, "int": int, "float": float, "bool": bool}


def plain(value: EntityValue) -> str:
    """The value of an attribute as text, as it would be in XML."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def value_of(entity: Entity, attribute: str, substitute: Substitute) -> ParameterValue:
    """The value of a parameter, with its substitutions carried out. Raises UnknownValue."""
    if attribute not in entity.attributes:
        raise UnknownValue(f"`{entity.tag}` has no `{attribute}`", "unsupported")
    value, stated = entity.attributes[attribute], entity.attributes.get("type")
    separator = entity.attributes.get(f"{attribute}-sep")
    if isinstance(value, str) and separator:
        return _list([_scalar(part, substitute, entity.typed) for part in value.split(str(separator))])
    if isinstance(value, list):
        return _list([_scalar(part, substitute, entity.typed) for part in value])
    if stated is None:
        return _plain_or_list(value, substitute, entity.typed)
    return _of_type(substitute(plain(value)), str(stated))


def _of_type(text: str, stated: str) -> ParameterValue:
    name = stated.removeprefix("List[").removesuffix("]") if stated.startswith("List[") else stated
    name = name.removeprefix("list_of_").rstrip("s") if stated.startswith("list_of_") else name
    wanted = _TYPES.get(name)
    if wanted is None:
        raise UnknownValue(f"`{stated}` is not a type of parameters", "parameters")
    if name != stated:
        found = _yaml(text)
        members = found if isinstance(found, list) else [found]
        values = [float(each) if wanted is float and isinstance(each, int) else each for each in members]
        if not all(isinstance(each, wanted) for each in values):
            raise UnknownValue(f"the value is not of the type `{stated}`", "parameters")
        return _list(values)
    if wanted is str:
        return text
    try:
        words = {"1": True, "0": False, "true": True, "false": False}
        return words[text.lower()] if wanted is bool else cast("ParameterValue", canonical(wanted(text)))
    except (KeyError, ValueError):
        raise UnknownValue(f"the value is not of the type `{stated}`", "parameters") from None


def _plain_or_list(value: Plain, substitute: Substitute, typed: bool) -> ParameterValue:
    if not isinstance(value, str) or (typed and "$(" not in value):
        return cast("ParameterValue", canonical(value))
    return _yaml(substitute(value))


def _scalar(value: Plain, substitute: Substitute, typed: bool) -> Plain:
    found = _plain_or_list(value, substitute, typed)
    if isinstance(found, list):
        raise UnknownValue("a list has lists as its values", "parameters")
    return found


def _yaml(text: str) -> ParameterValue:
    """``text`` read as YAML. Raises UnknownValue."""
    if not text:
        return ""
    try:
        value, _ = read_tree(Source("value", text)) or (None, None)
    except InvalidYaml:
        raise UnknownValue("the value is not valid YAML", "parameters") from None
    if isinstance(value, list):
        members = [member for member, _ in value if isinstance(member, (str, bool, int, float))]
        if len(members) == len(value):
            return _list(members)
    if value is None or isinstance(value, (dict, list)):
        raise UnknownValue("the value is no text, number, boolean or list of them", "parameters")
    return value


def _list(values: list[Plain]) -> ParameterValue:
    """Raises UnknownValue."""
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        return [float(value) for value in values]
    if len(kinds) > 1:
        raise UnknownValue("a list mixes types", "parameters")
    return [canonical(value) for value in values]
