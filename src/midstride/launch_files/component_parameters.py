"""The parameters that launch gives a composable node, where they are not those that ROS would give to a node.

Launch reads a parameter file of a composable node itself, with PyYAML. Of its sections, only `/**` and that with the
node's full name count, the latter last, wherever they stand; and a text in it is read once more, so `'5'` is a number.
A value that the launch file states is passed as it is, and not read again by ROS.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from midstride.launch_files.context import ParametersGiven
from midstride.model.component import ParameterValue


def launched_values(
    given: ParametersGiven, text: str, role: str, read: Mapping[str, ParameterValue]
) -> Mapping[str, Any]:
    """The values of one parameter file, or of what comes to one, for the composable node ``role``.

    ``read``: those that ROS would give to a node of that name, which are also those of a single parameter (`rule`).
    Raises ValueError if launch cannot read the ``text``.
    """
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    if given.rule is not None:
        return read
    try:
        loaded = yaml.safe_load(text)
        sections = dict(_sections(loaded, ()))
        stated = {**(sections.get("**") or {}), **(sections.get(role) or {})} if sections else loaded
        values = dict(_flat("", stated or {}))
        if given.path is None:
            return values
        return {name: _read_again(value, yaml.safe_load) for name, value in values.items()}
    except (yaml.YAMLError, TypeError, AttributeError) as error:
        raise ValueError(str(error)) from None


def _sections(stated: Any, names: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """The sections with their names, as launch takes them: slashes in front do not count."""
    for key, value in stated.items():
        if key == "ros__parameters":
            yield "/".join(names), value
            return
        if isinstance(value, Mapping):
            yield from _sections(value, (*names, key.lstrip("/")))


def _flat(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{prefix}{name}.", value)
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
