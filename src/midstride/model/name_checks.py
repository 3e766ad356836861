"""Checks of names: that each is well formed and declared once, and that every reference has a declaration.

A specification that passes can be built and walked without a KeyError;
:mod:`midstride.model.specification_checks` continues from there. An empty name means one that could not be read,
and is skipped.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Final

from midstride.model.component import (
    ROS_PARAMETERS,
    ComponentSpec,
    ContainerProgram,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
)
from midstride.model.diagnostics import Problem, SubjectPath, unknown_name, with_suggestions
from midstride.model.hosts import MANAGER
from midstride.model.load_words import LoadWords
from midstride.model.specification import TIMING, Keep, Node, Order, Specification

_TOKEN: Final = r"[A-Za-z_][A-Za-z0-9_]*"
_NAME: Final = re.compile(_TOKEN)
_ROLE: Final = re.compile(rf"{_TOKEN}(/{_TOKEN})*")
_TOPIC: Final = re.compile(rf"(/{_TOKEN})+")
_PACKAGE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_LONGEST: Final = 255  # what ROS 2 allows for a node name


def _invalid_name(kind: str, name: str, path: SubjectPath, *, read: bool = False) -> Iterator[Problem]:
    """``read``: an empty name could not be read, which has been reported already."""
    if (_NAME.fullmatch(name) is None or len(name) > _LONGEST) and not (read and not name):
        yield Problem("E006", path, f"`{name}` is not a valid {kind} name", _instead(name))


def _instead(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:_LONGEST]
    plain = f"_{plain}" if plain[:1].isdigit() or not plain else plain
    return f"use letters, digits and underscores, and start with no digit: `{plain}`"


def _twice(kind: str, names: Sequence[str], path: SubjectPath) -> Iterator[Problem]:
    for index, name in enumerate(names):
        if name and name in names[:index]:
            yield Problem("E007", (*path, str(index)), f"{kind} `{name}` is listed twice", "list it once")


def _unknown(
    kind: str, name: str, known: Collection[str], path: SubjectPath, declared: SubjectPath, of: str = ""
) -> Iterator[Problem]:
    if name and name not in known:
        message = unknown_name(kind, name, of)
        yield Problem("E008", path, message, declared=declared, candidates=(name, known))


# -- components --------------------------------------------------------------------------------------


def component_names(component: ComponentSpec, path: SubjectPath) -> list[Problem]:
    """The problems with the names of one component under ``path``."""
    return with_suggestions(list(_component_names(component, path)))


def _component_names(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    yield from _invalid_name("component", component.name, path, read=path == ())
    for name in component.input_order:
        yield from _invalid_name("port", name, (*path, "inputs", name))
    for index, name in enumerate(component.outputs):
        where = (*path, "outputs", str(index))
        yield from _invalid_name("port", name, where, read=True)
        if name in component.inputs:
            message = f"`{name}` names both an input and an output"
            yield Problem("E007", where, message, "the port names of a component are unique")
    yield from _twice("output", component.outputs, (*path, "outputs"))
    repeated = _repeated(component.functionality_order)
    for name in repeated:
        yield Problem("E007", (*path, "functionalities", name), f"functionality `{name}` is declared twice")
    for functionality in component.functionalities.values() if repeated else component:
        yield from _functionality_names(component, functionality, (*path, "functionalities", functionality.name))
    for name in sorted(component.parameters):
        if not name.isprintable() or not name:  # ROS 2 accepts any printable text, and parameter files use it
            yield Problem("E006", (*path, "parameters", name), f"`{name}` is not a valid parameter name")
    if component.run is not None:
        yield from _command(component.run, (*path, "run"))
    if component.package is not None:
        yield from _package(component, component.package, path)
    if component.container is not None:
        yield from _container(component.container, (*path, "container"))
    if component.prefix is not None:
        yield from _command(component.prefix, (*path, "prefix"))
        if component.run is None:
            yield Problem("E009", (*path, "prefix"), "a prefix is stated without a command", "name it: `run`")
    yield from _variables(component.environment, path)


def _variables(environment: Iterable[str], path: SubjectPath) -> Iterator[Problem]:
    for name in sorted(environment):
        if name.startswith("MIDSTRIDE_"):
            message = f"`{name}` of the environment is set by Midstride itself"
            yield Problem("E009", (*path, "environment", name), message, "remove it")


def _repeated(names: Sequence[str]) -> list[str]:
    return sorted(name for name, count in Counter(names).items() if count > 1)


# A specification is checked again for each change, and most of its commands are the same.
_words = lru_cache(maxsize=1024)(shlex.split)


def _command(text: str, path: SubjectPath) -> Iterator[Problem]:
    try:
        words = _words(text)
    except ValueError as error:
        yield Problem("E009", path, f"`{text}` is not a valid shell command: {str(error).lower()}")
        return
    if not words:
        yield Problem("E009", path, "the command is empty", "omit it if the component is started elsewhere")


def _package(component: ComponentSpec, package: str, path: SubjectPath) -> Iterator[Problem]:
    if not _PACKAGE.fullmatch(package):
        yield Problem("E009", (*path, "package"), f"`{package}` is not a valid package name")
    if component.run is None:
        yield Problem("E009", (*path, "package"), "a package is stated without an executable", "name it: `run`")
    elif component.container is not None:
        try:
            LoadWords.of(component.run)
        except ValueError as error:
            yield Problem("E009", (*path, "run"), f"`{component.run}` cannot be loaded into a container: {error}")
    elif "/" in component.run.partition(" ")[0]:
        message = f"`{component.run}` names a file, and package {package} is stated, which has executables"
        yield Problem("E009", (*path, "run"), message, "name the executable alone, or omit the package")


def _container(container: ContainerProgram, path: SubjectPath) -> Iterator[Problem]:
    where = (*path, "run")
    yield from _command(container.run, where)
    if "/" in container.run.partition(" ")[0]:
        message = f"`{container.run}` names a file, and a container is an executable of a package"
        yield Problem("E009", where, message, 'name the executable: `in "component_container_mt"`')
    if not _PACKAGE.fullmatch(container.package):
        message = f"`{container.package}` is not a valid package name"
        yield Problem("E009", (*path, "package"), message)


def _functionality_names(
    component: ComponentSpec, functionality: FunctionalitySpec, path: SubjectPath
) -> Iterator[Problem]:
    yield from _invalid_name("functionality", functionality.name, path)
    of = component.name or "the component"
    for kind, names, known, key in (
        ("input", functionality.inputs, component.input_order, "uses"),
        ("output", functionality.outputs, component.outputs, "produces"),
    ):
        for index, name in enumerate(names):
            yield from _unknown(kind, name, known, (*path, key, str(index)), (*path[:-2], f"{kind}s"), of)
        yield from _twice(kind, names, (*path, key))
    for name in _repeated([mode.name for mode in functionality.modes]):
        yield Problem("E007", (*path, "modes", name), f"mode `{name}` of {functionality.name} is declared twice")
    reported: set[str] = set()
    for mode in functionality.modes:
        yield from _mode_names(component, functionality, mode, (*path, "modes", mode.name), reported)


def _mode_names(
    component: ComponentSpec, functionality: FunctionalitySpec, mode: Mode, path: SubjectPath, reported: set[str]
) -> Iterator[Problem]:
    """The problems with the names of one mode. ``reported`` are ports reported for an earlier mode already."""
    yield from _invalid_name("mode", mode.name, path)
    for name in sorted(mode.guarantees):
        yield from _associated("output", name, component, functionality, (*path, "guarantees", name), reported)
    for index, assumption in enumerate(mode.assumptions):
        if isinstance(assumption, InputAlternatives):
            where = (*path, "assumes", str(index))
            yield from _twice("input", assumption.inputs, (*where, "any_of"))
            for name in assumption.inputs:
                yield from _associated("input", name, component, functionality, where, reported)


def _associated(
    kind: str,
    name: str,
    component: ComponentSpec,
    functionality: FunctionalitySpec,
    path: SubjectPath,
    reported: set[str],
) -> Iterator[Problem]:
    """A mode may refer only to the ports of the functionality that it belongs to."""
    key, verb = ("uses", "use") if kind == "input" else ("produces", "produce")
    ports = component.input_order if kind == "input" else component.outputs
    associated = functionality.inputs if kind == "input" else functionality.outputs
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
    return with_suggestions(list(_specification_names(specification)))


def _invalid_topic(topic: str, path: SubjectPath) -> Iterator[Problem]:
    if not _TOPIC.fullmatch(topic):
        yield Problem(
            "E006", path, f"`{topic}` is not a valid topic name", "write the full name, which starts with `/`"
        )


def _specification_names(specification: Specification) -> Iterator[Problem]:
    yield from _invalid_name("system", specification.name, ("system",), read=True)
    for name, connector in sorted(specification.connectors.items()):
        where = ("topics", name) if connector.topic == name else ("topics", name, "topic")
        yield from _invalid_topic(connector.topic, where)
    topics = {connector.topic for connector in specification.connectors.values()}
    for name in _repeated([offer.name for offer in specification.environment]):
        yield Problem("E007", ("environment", name), f"environment guarantee `{name}` is declared twice")
    for offer in specification.environment:
        yield from _invalid_name("environment guarantee", offer.name, ("environment", offer.name))
        if offer.topic is not None:
            yield from _unknown("topic", offer.topic, topics, ("environment", offer.name, "topic"), ("topics",))
    resources = {resource.name for resource in specification.resources.values()}
    for name, component in sorted(specification.components.items()):
        yield from _component_names(component, ("components", name))
        for resource in sorted(component.resource_usage):
            holder: SubjectPath = ("components", name, "holds", resource)
            yield from _unknown("resource", resource, resources, holder, ("resources",))
    for name in sorted(specification.hosts):
        yield from _invalid_name("host", name, ("hosts", name))
    for key, declared in sorted(specification.resources.items()):
        yield from _unknown_host(specification, declared.host, ("resources", key))
    for name, program in sorted(specification.containers.items()):
        yield from _shared_container(specification, name, program)
    for role, node in sorted(specification.nodes.items()):
        yield from _node_names(specification, node, ("nodes", role))
    for index in range(len(specification.constraints)):
        yield from _constraint_names(specification, index)
    for index, requirement in enumerate(specification.requirements):
        yield from _invalid_topic(requirement.topic, ("changes_require", str(index), "topic"))
    for kind in sorted(specification.timing):
        yield from _unknown("kind of step", kind, TIMING, ("timing_seconds", kind), ())


def _unknown_host(specification: Specification, host: str, path: SubjectPath) -> Iterator[Problem]:
    if host:
        yield from _unknown("host", host, {*specification.hosts, MANAGER}, (*path, "host"), ("hosts",))


def _shared_container(specification: Specification, name: str, program: ContainerProgram) -> Iterator[Problem]:
    path: SubjectPath = ("containers", name)
    if not _ROLE.fullmatch(name) or len(name) > _LONGEST:
        help = "write names joined by `/`, as in `robot1/pipeline`, without one in front"
        yield Problem("E006", path, f"`{name}` is not a valid name of a container", help)
    if name in specification.nodes:
        message = f"`{name}` names both a container and a node: the container has a ROS node of its name"
        yield Problem("E007", path, message, "use another name for one of them")
    yield from _unknown_host(specification, program.host, path)
    yield from _container(program, path)
    if program.prefix is not None:
        yield from _command(program.prefix, (*path, "prefix"))
    yield from _variables(program.environment, path)


def node_names(specification: Specification, node: Node, path: SubjectPath) -> list[Problem]:
    """The problems with the names of one node under ``path``."""
    return with_suggestions(list(_node_names(specification, node, path)))


def _node_names(specification: Specification, node: Node, path: SubjectPath) -> Iterator[Problem]:
    if not _ROLE.fullmatch(node.role) or len(node.role) > _LONGEST:
        help = "write names joined by `/`, as in `robot1/talker`, without one in front"
        yield Problem("E006", path, f"`{node.role}` is not a valid node name", help)
    yield from _unknown("component", node.component, specification.components, (*path, "component"), ("components",))
    component = specification.components.get(node.component)
    if node.container is not None:
        known = specification.containers
        yield from _unknown("container", node.container, known, (*path, "container"), ("containers",))
    yield from _unknown_host(specification, node.host, path)
    if node.respawn is not None and node.respawn.fallback is not None:
        where = (*path, "respawn", "fallback")
        yield from _unknown("component", node.respawn.fallback, specification.components, where, ("components",))
        if node.respawn.fallback_host:
            where, hosts = (*path, "respawn", "fallback_host"), {*specification.hosts, MANAGER}
            yield from _unknown("host", node.respawn.fallback_host, hosts, where, ("hosts",))
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
            # A program without the API declares its parameters itself, and a file may state more of them for one node.
            if name not in ROS_PARAMETERS and component.gate is None:
                yield from _unknown("parameter", name, component.parameters, where, declared, component.name)


def missing_for_constraints(specification: Specification, role: str) -> list[str]:
    """List in words what `keep` and `limit` constraints on ``role`` name and its component lacks."""
    return [
        f"{problem.message}, which `{constraint}` names"
        for index, constraint in enumerate(specification.constraints)
        if not isinstance(constraint, Order) and constraint.functionality.instance == role
        for problem in _constraint_names(specification, index)
    ]


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
    declared: SubjectPath = ("components", component.name, "functionalities")
    names = component.functionalities
    yield from _unknown("functionality", ref.functionality, names, where, declared, ref.instance)
    functionality = component.functionalities.get(ref.functionality)
    if functionality is not None and isinstance(constraint, Keep):
        modes = [mode.name for mode in functionality.modes]
        declared = (*declared, functionality.name, "modes")
        yield from _unknown("mode", constraint.mode, modes, (*path, "at"), declared, str(ref))
