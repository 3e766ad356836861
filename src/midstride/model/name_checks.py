"""Checks of names: that each is well formed and declared once, and that every reference has a declaration.

A specification that passes can be built and walked without a KeyError;
:mod:`midstride.model.specification_checks` continues from there. An empty name means one that could not be read,
and is skipped.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterator, Sequence
from typing import Final

from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.diagnostics import Problem, unknown_name, with_suggestions
from midstride.model.specification import DEFAULT_SECONDS, Keep, Node, Order, Specification

_TOKEN: Final = r"[A-Za-z_][A-Za-z0-9_]*"
_NAME: Final = re.compile(_TOKEN)
_ROLE: Final = re.compile(rf"/?{_TOKEN}(/{_TOKEN})*")
_TOPIC: Final = re.compile(rf"(/{_TOKEN})+")
_LONGEST: Final = 255  # what ROS 2 allows for a node name

Path = tuple[str, ...]


def is_name(text: str) -> bool:
    """Whether ``text`` may name a component, port, functionality or mode."""
    return _NAME.fullmatch(text) is not None and len(text) <= _LONGEST


def is_topic(text: str) -> bool:
    """Whether ``text`` is the full name of a topic."""
    return _TOPIC.fullmatch(text) is not None


def _invalid_name(kind: str, name: str, path: Path, *, read: bool = False) -> Iterator[Problem]:
    """``read``: an empty name could not be read, which has been reported already."""
    if not is_name(name) and not (read and not name):
        yield Problem("E006", path, f"`{name}` is not a valid {kind} name", _instead(name))


def _instead(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:_LONGEST]
    plain = f"_{plain}" if plain[:1].isdigit() or not plain else plain
    return f"use letters, digits and underscores, and start with no digit: `{plain}`"


def _twice(kind: str, names: Sequence[str], path: Path) -> Iterator[Problem]:
    for index, name in enumerate(names):
        if name and name in names[:index]:
            yield Problem("E007", (*path, str(index)), f"{kind} `{name}` is listed twice", "list it once")


def _unknown(
    kind: str, name: str, known: Collection[str], path: Path, declared: Path, of: str = ""
) -> Iterator[Problem]:
    if name and name not in known:
        message = unknown_name(kind, name, of)
        yield Problem("E008", path, message, declared=declared, candidates=(name, known))


# -- components --------------------------------------------------------------------------------------


def component_names(component: ComponentSpec, path: Path) -> list[Problem]:
    """The problems with the names of one component under ``path``."""
    found = list(_invalid_name("component", component.name, path, read=path == ()))
    for name in component.input_order:
        found += _invalid_name("port", name, (*path, "inputs", name))
    for index, name in enumerate(component.outputs):
        found += _invalid_name("port", name, (*path, "outputs", str(index)), read=True)
        if name in component.inputs:
            message = f"`{name}` names both an input and an output"
            found.append(
                Problem("E007", (*path, "outputs", str(index)), message, "the port names of a component are unique")
            )
    found += _twice("output", component.outputs, (*path, "outputs"))
    order = component.functionality_order
    for name in sorted({name for name in order if order.count(name) > 1}):
        found.append(Problem("E007", (*path, "functionalities", name), f"functionality `{name}` is declared twice"))
    for functionality in component.functionalities.values() if len(set(order)) < len(order) else component:
        found += _functionality_names(component, functionality, (*path, "functionalities", functionality.name))
    for name in sorted(component.parameters):
        if not name.isprintable() or not name:  # ROS 2 accepts any printable text, and parameter files use it
            found.append(Problem("E006", (*path, "parameters", name), f"`{name}` is not a valid parameter name"))
    if component.run is not None:
        found += _command(component.run, (*path, "run"))
    return with_suggestions(found)


def _command(text: str, path: Path) -> Iterator[Problem]:
    try:
        words = shlex.split(text)
    except ValueError as error:
        yield Problem("E009", path, f"`{text}` is not a valid shell command: {str(error).lower()}")
        return
    if not words:
        yield Problem("E009", path, "the command is empty", "omit it if the component is started elsewhere")


def _functionality_names(component: ComponentSpec, functionality: FunctionalitySpec, path: Path) -> Iterator[Problem]:
    yield from _invalid_name("functionality", functionality.name, path)
    of = component.name or "the component"
    for index, name in enumerate(functionality.inputs):
        declared = (*path[:-2], "inputs")
        yield from _unknown("input", name, component.input_order, (*path, "uses", str(index)), declared, of)
    for index, name in enumerate(functionality.outputs):
        declared = (*path[:-2], "outputs")
        yield from _unknown("output", name, component.outputs, (*path, "produces", str(index)), declared, of)
    yield from _twice("input", functionality.inputs, (*path, "uses"))
    yield from _twice("output", functionality.outputs, (*path, "produces"))
    modes = [mode.name for mode in functionality.modes]
    for name in sorted({name for name in modes if modes.count(name) > 1}):
        yield Problem("E007", (*path, "modes", name), f"mode `{name}` of {functionality.name} is declared twice")
    reported: set[str] = set()
    for mode in functionality.modes:
        yield from _mode_names(component, functionality, mode, (*path, "modes", mode.name), reported)


def _mode_names(
    component: ComponentSpec, functionality: FunctionalitySpec, mode: Mode, path: Path, reported: set[str]
) -> Iterator[Problem]:
    """The problems with the names of one mode. ``reported`` are ports reported for an earlier mode already."""
    yield from _invalid_name("mode", mode.name, path)
    for name in sorted(mode.guarantees):
        where = (*path, "guarantees", name)
        yield from _associated("output", name, component.outputs, functionality, functionality.outputs, where, reported)
    for index, assumption in enumerate(mode.assumptions):
        if not isinstance(assumption, InputAlternatives):
            continue
        where = (*path, "assumes", str(index))
        yield from _twice("input", assumption.inputs, (*where, "any_of"))
        for name in assumption.inputs:
            yield from _associated(
                "input", name, component.input_order, functionality, functionality.inputs, where, reported
            )


def _associated(
    kind: str,
    name: str,
    ports: Sequence[str],
    functionality: FunctionalitySpec,
    associated: Sequence[str],
    path: Path,
    reported: set[str],
) -> Iterator[Problem]:
    """A mode may refer only to the ports of its own functionality."""
    key, verb = ("uses", "use") if kind == "input" else ("produces", "produce")
    declared = (*path[:-4], key)  # from …/modes/<mode>/guarantees/<name>, or …/assumes/<index>
    if name not in ports:
        yield from _unknown(kind, name, associated, path, declared, functionality.name)
    elif name not in associated and name not in reported and set(associated) <= set(ports):  # else a misspelt one
        reported.add(name)
        message = f"{functionality.name} does not {verb} {name}, so its modes cannot refer to it"
        help = f"add {name} to what {functionality.name} `{key}`"
        yield Problem("E008", path, message, help, declared)


# -- systems -----------------------------------------------------------------------------------------


def specification_names(specification: Specification) -> list[Problem]:
    """The problems with the names of a whole specification."""
    found = list(_invalid_name("system", specification.name, ("system",), read=True))
    for name, connector in sorted(specification.connectors.items()):
        if not is_topic(connector.topic):
            where = ("topics", name) if connector.topic == name else ("topics", name, "topic")
            help = "write the full name, which starts with `/`"
            found.append(Problem("E006", where, f"`{connector.topic}` is not a valid topic name", help))
    topics = {connector.topic for connector in specification.connectors.values()}
    offers = [offer.name for offer in specification.environment]
    for name in sorted({name for name in offers if offers.count(name) > 1}):
        found.append(Problem("E007", ("environment", name), f"environment guarantee `{name}` is declared twice"))
    for offer in specification.environment:
        found += _invalid_name("environment guarantee", offer.name, ("environment", offer.name))
        if offer.topic is not None:
            found += _unknown("topic", offer.topic, topics, ("environment", offer.name, "topic"), ("topics",))
    for name, component in sorted(specification.components.items()):
        found += component_names(component, ("components", name))
        for resource in sorted(component.resource_usage):
            found += _unknown(
                "resource", resource, specification.resources, ("components", name, "holds", resource), ("resources",)
            )
    for role, node in sorted(specification.nodes.items()):
        found += _node_names(specification, node, ("nodes", role))
    for index in range(len(specification.constraints)):
        found += _constraint_names(specification, index)
    for kind in sorted(specification.timing):
        found += _unknown("kind of step", kind, DEFAULT_SECONDS, ("timing_seconds", kind), ())
    return with_suggestions(found)


def node_names(specification: Specification, node: Node, path: Path) -> list[Problem]:
    """The problems with the names of one node under ``path``."""
    return with_suggestions(list(_node_names(specification, node, path)))


def _node_names(specification: Specification, node: Node, path: Path) -> Iterator[Problem]:
    if not _ROLE.fullmatch(node.role) or len(node.role) > _LONGEST:
        yield Problem(
            "E006", path, f"`{node.role}` is not a valid node name", "write names joined by `/`, as in `robot1/talker`"
        )
    yield from _unknown("component", node.component, specification.components, (*path, "component"), ("components",))
    component = specification.components.get(node.component)
    for port in sorted(node.attachments):
        if component is not None:
            declared = ("components", component.name, "outputs")
            where = (*path, "attachments", port)
            yield from _unknown("port", port, component.ports(), where, declared, component.name)
        for index, topic in enumerate(node.attachments[port]):
            where = (*path, "attachments", port, str(index))
            yield from _unknown("topic", topic, specification.connectors, where, ("topics",))
    if component is not None:
        for name in sorted(node.parameters):
            declared = ("components", component.name, "parameters")
            where = (*path, "parameters", name)
            yield from _unknown("parameter", name, component.parameters, where, declared, component.name)


def _constraint_names(specification: Specification, index: int) -> Iterator[Problem]:
    constraint, path = specification.constraints[index], ("constraints", str(index))
    if isinstance(constraint, Order):
        for key, role in (("order", constraint.first), ("before", constraint.then)):
            yield from _unknown("node", role, specification.nodes, (*path, key), ("nodes",))
        return
    ref = constraint.functionality
    where = (*path, "keep" if isinstance(constraint, Keep) else "limit")
    if not ref.instance:
        message = f"`{ref.functionality}` is not a functionality"
        yield Problem("E008", where, message, "write it as `node.functionality`")
        return
    yield from _unknown("node", ref.instance, specification.nodes, where, ("nodes",))
    node = specification.nodes.get(ref.instance)
    component = None if node is None else specification.components.get(node.component)
    if component is None:
        return
    declared: Path = ("components", component.name, "functionalities")
    names = component.functionalities
    yield from _unknown("functionality", ref.functionality, names, where, declared, ref.instance)
    functionality = component.functionalities.get(ref.functionality)
    if functionality is not None and isinstance(constraint, Keep):
        modes = [mode.name for mode in functionality.modes]
        declared = (*declared, functionality.name, "modes")
        yield from _unknown("mode", constraint.mode, modes, (*path, "at"), declared, str(ref))
