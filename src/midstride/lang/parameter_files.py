"""ROS parameter files: their sections, and which nodes each section applies to.

The layout is that of ROS 2: a section is named after a node, with its namespace as a prefix or as enclosing sections,
or with wildcards (``/**``, ``/*/camera``), and contains ``ros__parameters``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.source import Source, Span
from midstride.lang.source_files import resolve_name
from midstride.lang.yaml_tree import InvalidYaml, Tree, read_tree
from midstride.model.component import ParameterValue

KEY: Final = "ros__parameters"


class ParameterValueAt(NamedTuple):
    """The value of a parameter, and where it is set."""

    value: ParameterValue
    span: Span


@dataclass(slots=True)
class ParameterSection:
    """The parameters of the nodes that match ``pattern``, by dotted name."""

    pattern: str
    span: Span
    values: dict[str, ParameterValueAt] = field(default_factory=dict)

    def matches(self, role: str, namespace: str) -> bool:
        """Whether the section applies to the node ``role``, in a file used in ``namespace``."""
        names = self.pattern, "/" + resolve_name(namespace, self.pattern)
        return any(re.fullmatch(_regex(name), "/" + role.strip("/")) for name in names)


def read_sections(source: Source, reporter: Reporter) -> list[ParameterSection] | None:
    """The sections of a parameter file; None if it is invalid, which is reported."""
    try:
        tree = read_tree(source, ros=True)
        return [] if tree is None else list(_sections(tree, ""))
    except InvalidYaml as refused:
        reporter.report("E150", refused.span, str(refused), help=refused.help)
        return None


def _sections(tree: Tree, prefix: str) -> Iterator[ParameterSection]:
    value, span = tree
    if not isinstance(value, dict):
        help = f"a parameter file has a section `node:` per node, each with `{KEY}:`"
        raise InvalidYaml(span, "expected a section of a ROS parameter file", help)
    for name, (content, place) in value.items():
        pattern = name if name.startswith("/") or not prefix else f"{prefix}/{name}"
        if not isinstance(content, dict):
            if prefix and content is not None:
                help = f"write `{prefix}: {KEY}: {name}: …`"
                raise InvalidYaml(place, f"`{name}` of section `{prefix}` is not under `{KEY}`", help)
            help = f"write the parameters under `{name}: {KEY}:`"
            raise InvalidYaml(place, f"section `{name}` has no `{KEY}`", help)
        if KEY in content:
            section = ParameterSection("/" + pattern.strip("/"), place)
            _flatten(content[KEY], "", section.values)
            yield section
        rest = {key: other for key, other in content.items() if key != KEY}
        if rest:
            yield from _sections((rest, place), pattern)


def _flatten(tree: Tree, prefix: str, into: dict[str, ParameterValueAt]) -> None:
    value, span = tree
    if not prefix and not isinstance(value, dict):
        if value is not None:
            raise InvalidYaml(span, f"`{KEY}` must contain parameters", f"write `{KEY}: name: value`")
        return
    if isinstance(value, dict):
        for name, inner in value.items():
            if not (name or prefix):
                raise InvalidYaml(inner[1], "the name of a parameter is empty")
            _flatten(inner, f"{prefix}.{name}" if prefix else name, into)
    elif isinstance(value, list):
        into[prefix] = ParameterValueAt(_listed(prefix, value, span), span)
    elif value is None:
        raise InvalidYaml(span, f"parameter `{prefix}` has no value")
    else:
        into[prefix] = ParameterValueAt(value, span)


def _listed(name: str, items: list[Tree], span: Span) -> ParameterValue:
    values: list[Any] = []
    for value, place in items:
        if value is None or isinstance(value, (dict, list)):
            raise InvalidYaml(place, f"parameter `{name}`: list values must be strings, numbers or booleans")
        values.append(value)
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        return [float(value) for value in values]
    if len(kinds) > 1:
        raise InvalidYaml(span, f"parameter `{name}`: a list cannot mix types")
    return values


def _regex(pattern: str) -> str:
    if pattern.strip("/") == "**":
        return "(/[^/]+)+"  # every node
    wildcards = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    return "".join(wildcards.get(part, "/" + re.escape(part)) for part in pattern.strip("/").split("/"))
