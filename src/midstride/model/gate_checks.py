"""What must hold of a component whose program does not use Midstride's API, and of its nodes (E027)."""

from __future__ import annotations

from collections.abc import Iterator

from midstride.model.component import ComponentSpec
from midstride.model.diagnostics import Problem
from midstride.model.name_checks import Path
from midstride.model.specification import Node

_CODE = "E027"


def gate_problems(component: ComponentSpec, path: Path) -> Iterator[Problem]:
    """The problems of one component under ``path``."""
    name = component.name
    for port in component.topics:
        where = (*path, "topics", port)
        if port not in component.inputs and not component.has_output(port):
            yield Problem(_CODE, where, f"{name} has no port {port}, for which a name of a topic is stated")
        elif component.gate is None:
            message = f"port {port} of {name} states what the program calls its topic, but {name} has no gate"
            yield Problem(_CODE, where, message, 'omit it, or state the gate: `run "…" gate preload`')
    if component.gate is None:
        return
    if component.run is None:
        message = f"{name} has a gate, but no `run` command: it must be started with its gate"
        yield Problem(_CODE, (*path, "gate"), message)
    if component.gate == "lifecycle" and len(component.functionalities) > 1:
        message = f"{name} has {len(component.functionalities)} functionalities; its node has one lifecycle state"
        help = "declare one functionality, or close the gate of each output as well: `gate lifecycle preload`"
        yield Problem(_CODE, (*path, "gate"), message, help)
    for functionality in component:
        if len(functionality.modes) > 2:
            message = f"{functionality.name} of {name} has {len(functionality.modes)} modes; with a gate there are two"
            help = "the gate is open in the normal mode, and closed in the degraded one"
            yield Problem(_CODE, (*path, "functionalities", functionality.name), message, help)
    for parameter, declared in sorted(component.parameters.items()):
        if declared.changeable:
            message = f"parameter {parameter} of {name} cannot be set in place: {name} does not use Midstride's API"
            yield Problem(_CODE, (*path, "parameters", parameter), message, "omit `changeable`")


def gated_node_problems(component: ComponentSpec, node: Node, path: Path) -> Iterator[Problem]:
    """The problems of one node of ``component`` under ``path``."""
    if component.gate is None:
        return
    for port, topics in sorted(node.attachments.items()):
        if len(topics) > 1:
            message = f"{node.role}.{port} is attached to {len(topics)} topics; with a gate, a port has one topic"
            yield Problem(_CODE, (*path, "attachments", port), message)
