"""The parameters that launch gives a composable node, where they are not those that ROS would give to a node.

Launch reads a parameter file of a composable node itself, with PyYAML. Of its sections, only `/**` and that with the
node's full name count, the latter last, wherever they stand; and a text in it is read once more, so `'5'` is a number.
A value that the launch file states is passed as it is, and not read again by ROS.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from typing import Any

from midstride.errors import NOT_OF_TAG
from midstride.launch_files.context import ParametersGiven


def launched_values(given: ParametersGiven, text: str, role: str) -> Mapping[str, Any]:
    """The values of one parameter file, or of what comes to one, for the composable node ``role``.

    ``text``: that of the file. Raises ValueError if launch cannot read it.
    """
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    try:
        if given.rule is not None:  # of a parameter for all nodes, which has a list in the form of Python
            name, _, stated_as = given.rule.partition(":=")
            is_list = stated_as.startswith("(") and stated_as.endswith(")")
            return {name: list(ast.literal_eval(stated_as)) if is_list else yaml.safe_load(stated_as)}
        loaded = yaml.safe_load(text)
        sections = dict(_sections(loaded, ()))
        stated = {**(sections.get("**") or {}), **(sections.get(role) or {})} if sections else loaded
        values = dict(flat(stated or {}))
        if given.path is None:
            return values
        return {name: _read_again(value, yaml.safe_load) for name, value in values.items()}
    except (yaml.YAMLError, *NOT_OF_TAG, SyntaxError) as error:
        raise ValueError(str(error)) from None


def _sections(stated: Any, names: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """The sections with their names, as launch takes them: slashes in front do not count."""
    for key, value in stated.items():
        if key == "ros__parameters":
            yield "/".join(names), value
            return
        if isinstance(value, Mapping):
            yield from _sections(value, (*names, key.lstrip("/")))


def flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The parameters of nested ``values``: a dot between the names."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _read_again(value: Any, load: Any) -> Any:
    """A text is read as YAML; one of another kind stays as it is."""
    if isinstance(value, str) and value:
        again = load(value)
        return again if isinstance(again, (bool, int, float, str, list)) else value
    if isinstance(value, list) and value and all(isinstance(each, str) for each in value):
        return [load(each) for each in value]
    return value
