"""The parameters that roslaunch sets on the parameter server, and which nodes have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from midstride.lang.source import Span
from midstride.launch_files.context import ParametersGiven, Stated
from midstride.launch_files.findings import ImportFindings
from midstride.launch_files.launched_nodes import LaunchedNode
from midstride.launch_files.roslaunch_values import canonical, stated, unrolled
from midstride.model.component import ParameterValue


class ParameterServer:
    """All parameters by full name; of several values of one, the last counts. They are set before any node starts."""

    def __init__(self) -> None:
        self._values: dict[str, Stated] = {}

    def set(self, name: str, value: Any, span: Span) -> None:
        """Set a parameter by its full name, or those of a mapping below it. Raises UnknownValue."""
        self._values.update([(canonical(each), Stated(single, span)) for each, single in unrolled(name, value)])

    def distributed(
        self, nodes: Sequence[LaunchedNode], findings: ImportFindings
    ) -> tuple[list[LaunchedNode], dict[str, Stated]]:
        """The nodes, each with the private parameters that the language can state, and the other parameters."""
        of_nodes: dict[str, list[tuple[str, Stated]]] = {f"/{node.role}/": [] for node in nodes}
        others: dict[str, Stated] = {}
        for name, found in self._values.items():
            owner = max((each for each in of_nodes if name.startswith(each)), key=len, default="")
            short = name.removeprefix(owner).replace("/", ".")
            if not owner or "." in name or stated(found.value) is None:
                others[name] = found
                continue
            of_nodes[owner].append((short, found))
            if repr(stated(found.value)) != repr(found.value):
                message = f"the list `{name}` mixes integers and other numbers; here none is an integer"
                findings.add("parameters", message, found.span, left_out=False)
        return [
            replace(node, settings=tuple(_given(short, found) for short, found in of_nodes[f"/{node.role}/"]))
            for node in nodes
        ], others


def _given(name: str, found: Stated) -> ParametersGiven:
    value: ParameterValue | None = stated(found.value)
    assert value is not None
    return ParametersGiven(found.span, values={name: value})
