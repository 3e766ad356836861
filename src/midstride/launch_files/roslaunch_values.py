"""The values of parameters in launch files of ROS 1, with the types that roslaunch gives them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from midstride.errors import NOT_OF_TAG
from midstride.launch_files.entity import MAX_NESTING, MAX_VALUES
from midstride.launch_files.expression import evaluate, shortened
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.roslaunch_grammar import refused
from midstride.launch_files.substitutions import truth
from midstride.launch_files.values import MAX_TEXT
from midstride.model.component import ParameterValue

TYPES: Final = ("auto", "str", "string", "int", "double", "bool", "boolean", "yaml")

_ANGLES: Final = {"!degrees": re.compile(r"^deg\([^)]*\)$"), "!radians": re.compile(r"^rad\([^)]*\)$")}


def converted(text: str, kind: str) -> Any:
    """``text`` as a value of one of TYPES. Raises UnknownValue."""
    try:
        match kind:
            case "auto":
                return guessed(text)
            case "str" | "string":
                return text
            case "int":
                return int(text)
            case "double":
                return float(text)
            case "bool" | "boolean":
                return truth(text)
            case "yaml":
                return read_yaml(text)
    except (ValueError, UnknownValue) as error:
        if isinstance(error, UnknownValue) and error.kind == "parameters":
            raise
        raise refused(f"`{shortened(text)}` is no {kind}") from None
    raise refused(f"`{kind}` is not a type of parameters, which are {', '.join(TYPES)}")


def guessed(text: str) -> ParameterValue:
    """The value of a text whose type is not stated: a number, a boolean, or the text."""
    try:
        if "." in text:
            return float(text)
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    return text.lower() == "true" if text.lower() in {"true", "false"} else text


def read_yaml(text: str) -> Any:
    """A document as `rosparam` reads it, with `rad(…)` and `deg(…)` for angles. Raises UnknownValue."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    class _Loader(yaml.SafeLoader):  # type: ignore[misc]
        pass

    def angle(loader: Any, node: Any) -> float:
        written = str(loader.construct_scalar(node)).strip()
        in_degrees = node.tag == "!degrees"
        inside = written[4:-1] if written.startswith("deg(" if in_degrees else "rad(") else written
        return float(inside) * math.pi / 180 if in_degrees else float(evaluate(inside))

    for tag, pattern in _ANGLES.items():
        _Loader.add_constructor(tag, angle)
        _Loader.add_implicit_resolver(tag, pattern, ["d", "r"])
    if len(text) > MAX_TEXT:
        raise UnknownValue("the document is too long", "parameters")
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "it" if mark is None else f"its line {mark.line + 1}"
        raise UnknownValue(f"{where} is not valid YAML", "parameters") from None
    except (*NOT_OF_TAG, UnknownValue):
        raise UnknownValue("it has a value that cannot be read", "parameters") from None


def unrolled(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The parameters of ``value``: those in a mapping are below its name. Raises UnknownValue."""
    left = MAX_VALUES

    def below(name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
        nonlocal left
        left -= 1
        if left < 0 or depth > MAX_NESTING:  # aliases may repeat values without end
            raise UnknownValue("it has more than can be read", "parameters")
        if not isinstance(value, dict):
            yield name, value
            return
        for key, each in value.items():
            if not isinstance(key, str) or not key:
                raise UnknownValue(f"the key `{shortened(str(key))}` is no name of a parameter", "parameters")
            yield from below(below_name(name, key), each, depth + 1)

    return below(name, value, 0)


def below_name(namespace: str, name: str) -> str:
    """A name in a namespace, unless it is a global or a private one."""
    return name if name[:1] in {"/", "~"} or not namespace else f"{namespace.rstrip('/')}/{name}"


def canonical(name: str) -> str:
    """A name without superfluous slashes."""
    parts = "/".join(part for part in name.split("/") if part)
    return f"/{parts}" if name.startswith("/") else parts


def stated(value: Any) -> ParameterValue | None:
    """``value`` as one of the language; None where it has no such value."""
    if isinstance(value, (bool, int, float, str)):
        return value
    if not isinstance(value, list) or not value:
        return None
    kinds = {type(each) for each in value}
    if kinds == {int, float}:  # which nodes read as numbers
        return [float(each) for each in value]
    return value if len(kinds) == 1 and kinds <= {bool, int, float, str} else None


def server_file(values: Mapping[str, Any]) -> str:
    """Parameters by full name as a file that `rosparam load` reads."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    document: dict[str, Any] = {}
    for name, value in values.items():
        at = document
        *above, last = name.strip("/").split("/")
        for part in above:
            inner = at.get(part)
            if not isinstance(inner, dict):
                inner = at[part] = {}
            at = inner
        at[last] = value
    return str(yaml.safe_dump(document, allow_unicode=True, width=100_000))
