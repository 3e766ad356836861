"""Names: what may be one, that each is declared once, and that what is named is declared.

What passes here can be built and walked without a KeyError; :mod:`midstride.model.specification_checks` goes on
from there. A name that is empty stands for one that could not be read, and is passed over.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterator, Sequence
from typing import Final

from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.diagnostics import Problem, suggested
from midstride.model.specification import DEFAULT_SECONDS, Keep, Node, Order, Specification

_TOKEN: Final = r"[A-Za-z_][A-Za-z0-9_]*"
_NAME: Final = re.compile(_TOKEN)
_ROLE: Final = re.compile(rf"/?{_TOKEN}(/{_TOKEN})*")
_TOPIC: Final = re.compile(rf"(/{_TOKEN})+")
_TYPE: Final = re.compile(rf"{_TOKEN}/(msg/)?{_TOKEN}")
_LONGEST: Final = 255  # what ROS 2 allows of a node's name

Path = tuple[str, ...]


def is_name(text: str) -> bool:
    """Whether ``text`` may name a component, port, functionality or mode."""
    return _NAME.fullmatch(text) is not None and len(text) <= _LONGEST


def is_topic(text: str) -> bool:
    """Whether ``text`` is the full name of a topic."""
    return _TOPIC.fullmatch(text) is not None


def is_message_type(text: str) -> bool:
    return _TYPE.fullmatch(text) is not None


def _not_a_name(kind: str, name: str, path: Path, *, read: bool = False) -> Iterator[Problem]:
    """``read``: where it is empty its reading has failed, which has been told."""
    if not is_name(name) and not (read and not name):
        yield Problem("E006", path, f"`{name}` cannot name a {kind}", _instead(name))


def _instead(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:_LONGEST]
    plain = f"_{plain}" if plain[:1].isdigit() or not plain else plain
    return f"letters, digits and underscores, no digit first: `{plain}`"


def _twice(kind: str, names: Sequence[str], path: Path) -> Iterator[Problem]:
    for index, name in enumerate(names):
        if name and name in names[:index]:
            yield Problem("E007", (*path, str(index)), f"the {kind} `{name}` is named twice", "once is enough")


def _unknown(
    kind: str, name: str, known: Collection[str], path: Path, declared: Path, of: str = ""
) -> Iterator[Problem]:
    if name and name not in known:
        message = f"there is no {kind} `{name}`{of}"
        yield Problem("E008", path, message, declared=declared, candidates=(name, known))


# -- components --------------------------------------------------------------------------------------


def component_names(component: ComponentSpec, path: Path) -> list[Problem]:
    """The faults in the names of one component under ``path``."""
    found = list(_not_a_name("component", component.name, path, read=path == ()))
    for name in component.input_order:
        found += _not_a_name("port", name, (*path, "inputs", name))
    for index, name in enumerate(component.outputs):
        found += _not_a_name("port", name, (*path, "outputs", str(index)), read=True)
        if name in component.inputs:
            message = f"`{name}` names an input and an output"
            found.append(
                Problem(
                    "E007", (*path, "outputs", str(index)), message, "the ports of a component share one space of names"
                )
            )
    found += _twice("output", component.outputs, (*path, "outputs"))
    order = component.functionality_order
    for name in sorted({name for name in order if order.count(name) > 1}):
        found.append(Problem("E007", (*path, "functionalities", name), f"there are two functionalities `{name}`"))
    for functionality in component.functionalities.values() if len(set(order)) < len(order) else component:
        found += _functionality_names(component, functionality, (*path, "functionalities", functionality.name))
    for name in sorted(component.parameters):
        if not name.isprintable() or not name:  # ROS 2 takes any words, and parameter files have them
            found.append(Problem("E006", (*path, "parameters", name), f"`{name}` cannot name a parameter"))
    if component.run is not None:
        found += _command(component.run, (*path, "run"))
    return suggested(found)


def _command(text: str, path: Path) -> Iterator[Problem]:
    try:
        words = shlex.split(text)
    except ValueError as error:
        yield Problem("E009", path, f"`{text}` cannot be split as a shell would: {str(error).lower()}")
        return
    if not words:
        yield Problem("E009", path, "the command is empty", "leave it out where the component is started elsewhere")


def _functionality_names(component: ComponentSpec, functionality: FunctionalitySpec, path: Path) -> Iterator[Problem]:
    yield from _not_a_name("functionality", functionality.name, path)
    of = f" of {component.name or 'the component'}"
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
        yield Problem("E007", (*path, "modes", name), f"two modes of {functionality.name} are called `{name}`")
    told: set[str] = set()
    for mode in functionality.modes:
        yield from _mode_names(component, functionality, mode, (*path, "modes", mode.name), told)


def _mode_names(
    component: ComponentSpec, functionality: FunctionalitySpec, mode: Mode, path: Path, told: set[str]
) -> Iterator[Problem]:
    """The faults in the names of one mode. ``told`` are the ports that an earlier mode has been blamed for."""
    yield from _not_a_name("mode", mode.name, path)
    for name in sorted(mode.guarantees):
        where = (*path, "guarantees", name)
        yield from _associated("output", name, component.outputs, functionality, functionality.outputs, where, told)
    for index, assumption in enumerate(mode.assumptions):
        if not isinstance(assumption, InputAlternatives):
            continue
        where = (*path, "assumes", str(index))
        yield from _twice("input", assumption.inputs, (*where, "any_of"))
        for name in assumption.inputs:
            yield from _associated(
                "input", name, component.input_order, functionality, functionality.inputs, where, told
            )


def _associated(
    kind: str,
    name: str,
    ports: Sequence[str],
    functionality: FunctionalitySpec,
    associated: Sequence[str],
    path: Path,
    told: set[str],
) -> Iterator[Problem]:
    """A mode may speak only of ports that are its functionality's."""
    key, verb = ("uses", "use") if kind == "input" else ("produces", "produce")
    declared = (*path[:-4], key)  # from …/modes/<mode>/guarantees/<name>, or …/assumes/<index>
    if name not in ports:
        yield from _unknown(kind, name, associated, path, declared, f" of {functionality.name}")
    elif name not in associated and name not in told and set(associated) <= set(ports):  # else a misspelt one is told
        told.add(name)
        message = f"{functionality.name} does not {verb} {name}, and so its modes cannot speak of it"
        help = f"let {functionality.name} {verb} {name}: add it to what it `{key}`"
        yield Problem("E008", path, message, help, declared)


# -- systems -----------------------------------------------------------------------------------------


def specification_names(specification: Specification) -> list[Problem]:
    """The faults in the names of a whole specification."""
    found = list(_not_a_name("system", specification.name, ("system",), read=True))
    for name, connector in sorted(specification.connectors.items()):
        if not is_topic(connector.topic):
            where = ("topics", name) if connector.topic == name else ("topics", name, "topic")
            help = "a topic has its full name, which starts with `/`"
            found.append(Problem("E006", where, f"`{connector.topic}` cannot name a topic", help))
    topics = {connector.topic for connector in specification.connectors.values()}
    offers = [offer.name for offer in specification.environment]
    for name in sorted({name for name in offers if offers.count(name) > 1}):
        found.append(Problem("E007", ("environment", name), f"two guarantees of the environment are called `{name}`"))
    for offer in specification.environment:
        found += _not_a_name("guarantee", offer.name, ("environment", offer.name))
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
    return suggested(found)


def node_names(specification: Specification, node: Node, path: Path) -> list[Problem]:
    """The faults in the names of one node under ``path``."""
    return suggested(list(_node_names(specification, node, path)))


def _node_names(specification: Specification, node: Node, path: Path) -> Iterator[Problem]:
    if not _ROLE.fullmatch(node.role) or len(node.role) > _LONGEST:
        yield Problem("E006", path, f"`{node.role}` cannot name a node", "names joined by `/`, as in `robot1/talker`")
    yield from _unknown("component", node.component, specification.components, (*path, "component"), ("components",))
    component = specification.components.get(node.component)
    for port in sorted(node.attachments):
        if component is not None:
            declared = ("components", component.name, "outputs")
            where = (*path, "attachments", port)
            yield from _unknown("port", port, component.ports(), where, declared, f" of {component.name}")
        for index, topic in enumerate(node.attachments[port]):
            where = (*path, "attachments", port, str(index))
            yield from _unknown("topic", topic, specification.connectors, where, ("topics",))
    if component is not None:
        for name in sorted(node.parameters):
            declared = ("components", component.name, "parameters")
            where = (*path, "parameters", name)
            yield from _unknown("parameter", name, component.parameters, where, declared, f" of {component.name}")


def _constraint_names(specification: Specification, index: int) -> Iterator[Problem]:
    constraint, path = specification.constraints[index], ("constraints", str(index))
    if isinstance(constraint, Order):
        for key, role in (("order", constraint.first), ("before", constraint.then)):
            yield from _unknown("node", role, specification.nodes, (*path, key), ("nodes",))
        return
    ref = constraint.functionality
    where = (*path, "keep" if isinstance(constraint, Keep) else "limit")
    if not ref.instance:
        message = f"`{ref.functionality}` names no functionality"
        yield Problem("E008", where, message, "write it as `node.functionality`")
        return
    yield from _unknown("node", ref.instance, specification.nodes, where, ("nodes",))
    node = specification.nodes.get(ref.instance)
    component = None if node is None else specification.components.get(node.component)
    if component is None:
        return
    declared: Path = ("components", component.name, "functionalities")
    of = f" of {ref.instance}"
    yield from _unknown("functionality", ref.functionality, component.functionalities, where, declared, of)
    functionality = component.functionalities.get(ref.functionality)
    if functionality is not None and isinstance(constraint, Keep):
        modes = [mode.name for mode in functionality.modes]
        declared = (*declared, functionality.name, "modes")
        yield from _unknown("mode", constraint.mode, modes, (*path, "at"), declared, f" of {ref}")
