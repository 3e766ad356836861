"""The rules for a component whose program does not use Midstride's API, and for its nodes (E027, E028)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

from midstride.model.component import DEFAULT_CONTAINER, DEFAULT_STOP, ComponentSpec, value_fits, value_kind
from midstride.model.diagnostics import Problem, SubjectPath
from midstride.model.lifecycle_management import managed_nodes
from midstride.model.specification import Node, Specification
from midstride.model.wording import KIND_WORDS

_CODE = "E027"
# The program that the simulator runs in the place of a composable node: it uses Midstride's API.
_STAND_IN = "python3 -m midstride.simulation.stand_in "
_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def _once(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """Yield what a component cannot have whose program ends."""
    name, help = component.name, "omit it, or omit `once`: a program that is done has none"
    if component.run is None:
        yield Problem("E028", (*path, "once"), f"{name} is `once`, but has no `run` command", "state the command")
    if component.gate != "none":
        message = f"{name} is `once`, and has a gate (`gate {component.gate}`)"
        yield Problem("E028", (*path, "gate"), message, help)
    parts = [("inputs", each, component.port_in_words(each)) for each in component.input_order]
    parts += [("outputs", str(index), component.port_in_words(each)) for index, each in enumerate(component.outputs)]
    parts += [("functionalities", each, f"functionality {each}") for each in component.functionality_order]
    parts += [("holds", each, f"it holds {each}") for each in sorted(component.resource_usage)]
    parts += [("allows", str(index), f"it allows {each}") for index, each in enumerate(component.allows)]
    for kind, key, what in parts:
        message = f"{name} is `once`, so it ends, and yet {what if what.startswith('it ') else f'it has {what}'}"
        yield Problem("E028", (*path, kind, key), message, help)


def gate_problems(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """The problems of one component under ``path``."""
    name = component.name
    for port in component.topics:
        where = (*path, "topics", port)
        if port not in component.inputs and not component.has_output(port):
            yield Problem(_CODE, where, f"{name} has no port {port}, for which a name of a topic is stated")
        elif component.gate is None:
            connector = KIND_WORDS[component.kind_of(port)].connector
            message = f"port {port} of {name} states what the program calls its {connector}, but {name} has no gate"
            yield Problem(_CODE, where, message, 'omit it, or state the gate: `run "…" gate preload`')
    yield from _services(component, path)
    yield from _mode_parameters(component, path)
    yield from _of_a_program(component, path)
    if component.once:
        yield from _once(component, path)
    yield from _named(component, path)
    if component.container is not None:
        yield from _composable(component, path)
    if component.gate is None:
        return
    if component.run is None and not component.once:
        message = f"{name} has a gate, but no `run` command: it must be started with its gate"
        yield Problem(_CODE, (*path, "gate"), message)
    if component.gate == "relay":
        yield from _relayed(component, path)
    if component.gate == "lifecycle" and len(component.functionalities) > 1:
        message = f"{name} has {len(component.functionalities)} functionalities; its node has one lifecycle state"
        help = "declare one functionality, or close the gate of each output as well: `gate lifecycle preload`"
        yield Problem(_CODE, (*path, "gate"), message, help)
    for functionality in component:
        for mode in functionality.modes[1:-1]:
            if not functionality.mode_parameters():
                where = (*path, "functionalities", functionality.name, "modes", mode.name)
                message = f"mode {mode.name} of {functionality.name} does the same as the normal mode"
                help = "with a gate, state what differs: `parameters { … }`; the gate is closed in the last mode only"
                yield Problem(_CODE, where, message, help)
    for port in sorted(component.conditions):
        message = f"input {port} of {name} cannot be a condition: {name} does not use Midstride's API"
        yield Problem(_CODE, (*path, "inputs", port, "condition"), message, "omit `condition`")


def _services(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """Yield the clients of a program behind a relay: what it calls passes the relay by."""
    if component.run is None or component.gate != "relay":
        return
    for port in component.service_ports():
        if component.has_output(port):
            continue
        where = (*path, "inputs", port)
        because = f"{component.name} uses `gate relay`, which passes on its messages and its answers, and not its calls"
        message = f"{component.port_in_words(port)} cannot be declared yet: {because}"
        help = 'state another gate (`run "…" gate preload`), or omit it and state `allows`'
        yield Problem(_CODE, where, message, help)


def _named(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """Yield what is stated of the name of its node, and does not fit."""
    name, renames = component.name, component.renames
    if renames is not None and component.unnamed:
        message = f"{name} is `unnamed`, so its node keeps its name, and yet it `renames {renames}`"
        yield Problem(_CODE, (*path, "renames"), message, "omit one of the two")
    if renames is not None and not _NODE_NAME.fullmatch(renames):
        message = f"{name} renames the node {renames!r}, which is no name of a node"
        yield Problem(_CODE, (*path, "renames"), message, "letters, digits and underscores, and no namespace")
    stated = {"unnamed": "is `unnamed`" if component.unnamed else "", "renames": renames and f"`renames {renames}`"}
    for key, what in stated.items():
        if what and component.gate is None:
            message = f"{name} {what}, but has no gate: it uses Midstride's API, which names its node after its role"
            help = (
                f'omit it, or state the gate: `run "…" gate preload {key}{f" {renames}" if key == "renames" else ""}`'
            )
            yield Problem(_CODE, (*path, key), message, help)


def _composable(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """Yield what does not fit a composable node, which a container loads."""
    name = component.name
    if component.package is None:
        message = f"{name} is a composable node, and no package is stated, which has the library with its class"
        yield Problem(_CODE, (*path, "container"), message, 'state it: `run component "…" package "…"`')
    if component.gate is None and component.run is not None:
        message = f"{name} is a composable node, and has no gate: none of these uses Midstride's API"
        yield Problem(
            _CODE, (*path, "container"), message, 'state the gate: `run component "…" package "…" gate preload`'
        )
    relayed = component.gate == "relay"
    stated = {
        "once": ("it is `once`", "a container does not end when its node has done its work")
        if component.once
        else None,
        "gate": ("it has `gate relay`", "a relay starts programs; state another gate: `gate preload`")
        if relayed
        else None,
        "unnamed": ("it is `unnamed`", "a request to load a node states its name") if component.unnamed else None,
        "renames": (f"it `renames {component.renames}`", "the name is that of the node that is loaded")
        if component.renames is not None
        else None,
    }
    for key, found in stated.items():
        if found is not None:
            what, why = found
            yield Problem(_CODE, (*path, key), f"{name} is a composable node, and yet {what}", f"omit it: {why}")


def _of_a_program(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """Yield what is stated of the process and the endpoints of a program that does not use Midstride's API."""
    name = component.name
    if component.gate is None and component.stop_times != replace(DEFAULT_STOP, patience=component.stop_times.patience):
        message = f"{name} states how its process is ended, but has no gate: it uses Midstride's API, and ends in order"
        help = "state no more than `stop patience`; `on_stop(…, timeout=…)` in its code says how long the rest may take"
        yield Problem(_CODE, (*path, "stop_seconds"), message, help)
    elif component.stop is not None and component.gate is not None and not component.loads_library:
        with_goals = component.gate == "relay" and any(
            component.kind_of(port) == "action" for port in component.outputs
        )
        for key, stated, usual, what in (
            ("drain", component.stop.drain, DEFAULT_STOP.drain, "answers requests that it has taken"),
            ("patience", component.stop.patience, DEFAULT_STOP.patience, "continues the goals of its ROS actions"),
        ):
            if stated != usual and not (key == "patience" and with_goals):
                message = f"{name} states for how long it {what}, and only the preloaded library keeps to that"
                help = f'omit `{key}`, or have the library preloaded: `run "…" gate preload`'
                yield Problem(_CODE, (*path, "stop_seconds", key), message, help)
    if component.activate_seconds is not None and component.gate is None:
        message = f"{name} states how long it may take to activate, but it is no lifecycle node"
        help = 'omit it, or state the gate: `run "…" gate lifecycle`'
        yield Problem(_CODE, (*path, "activate_seconds"), message, help)
    for port in sorted(component.lazy):
        where = (*path, "lazy", port)
        if not component.has_output(port):
            yield Problem(_CODE, where, f"{name} has no output {port}, which is stated to be lazy")
        elif component.gate is None:
            message = f"output {port} of {name} cannot be lazy: Midstride's API creates it when the program starts"
            yield Problem(_CODE, where, message, 'omit `lazy`, or state the gate: `run "…" gate preload`')


def _relayed(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """A relay passes messages of a known type on or not."""
    for functionality in component:
        for output in functionality.outputs:
            if all(mode.guarantees.get(output) is None for mode in functionality.modes):
                message = f"output {output} of {component.name} has no type, and a relay needs it"
                help = f"state it in a mode of {functionality.name}: `guarantee {output} : std_msgs/msg/String`"
                yield Problem(_CODE, (*path, "functionalities", functionality.name), message, help)


def _mode_parameters(component: ComponentSpec, path: SubjectPath) -> Iterator[Problem]:
    """The problems of parameters that modes set."""
    owners: dict[str, str] = {}
    for functionality in component:
        for mode in functionality.modes:
            for name, value in sorted(mode.parameters.items()):
                where = (*path, "functionalities", functionality.name, "modes", mode.name, "parameters", name)
                declared = component.parameters.get(name)
                owner = owners.setdefault(name, functionality.name)
                what = f"mode {mode.name} of {functionality.name} sets {name}"
                if component.gate is None:
                    message = f"{what}, but {component.name} uses Midstride's API"
                    yield Problem(_CODE, where, message, "set it in the code of the mode")
                elif declared is None:
                    help = f"declare it with its value for the other modes: `parameters {{ {name} = … }}`"
                    yield Problem(_CODE, where, f"{what}, which {component.name} does not declare", help)
                elif not value_fits(value, declared.value):
                    message = f"{what} to {value_kind(value)}, and it is declared as {value_kind(declared.value)}"
                    yield Problem(_CODE, where, message)
                elif owner != functionality.name:
                    help = "a parameter belongs to the modes of one functionality"
                    yield Problem(_CODE, where, f"{what}, which the modes of {owner} set as well", help)


def managed_twice(specification: Specification) -> Iterator[Problem]:
    """Yield the lifecycle nodes that Midstride manages, and a lifecycle manager of the same system as well."""
    for role, node in sorted(specification.nodes.items()):
        component = specification.components.get(node.component)
        if component is None:
            continue
        values = {name: each.value for name, each in component.parameters.items()} | dict(node.parameters)
        for name in managed_nodes(f"/{role}", values):
            managed = specification.nodes.get(name.strip("/"))
            own = None if managed is None else specification.components.get(managed.component)
            if own is not None and own.has_lifecycle:
                message = f"{name} has `gate {own.gate}`, and {role} manages its lifecycle as well (`node_names`)"
                help = f"omit {role}, or declare {own.name} with `gate preload`: only one of them may manage it"
                yield Problem(_CODE, ("nodes", name.strip("/"), "component"), message, help)


def _shared(component: ComponentSpec, node: Node, path: SubjectPath) -> Iterator[Problem]:
    """Yield what a node cannot state of its process, as others are in that."""
    where = f"{node.role} is in the container {node.container}"
    if component.container != DEFAULT_CONTAINER:
        message = f"{where}, and {component.name} states another program"
        yield Problem(_CODE, path, message, 'omit `in "…"` after the package, or `in` here')
    for what in (["a prefix"] if component.prefix else []) + (["an environment"] if component.environment else []):
        message = f"{where}, and {component.name} states {what}, which only a process has"
        yield Problem(_CODE, path, message, f"state it for the container: `container {node.container} {{ … }}`")


def gated_node_problems(component: ComponentSpec, node: Node, path: SubjectPath) -> Iterator[Problem]:
    """The problems of one node of ``component`` under ``path``."""
    if node.container is not None and component.container is not None:
        yield from _shared(component, node, (*path, "container"))
    elif node.container is not None and not (component.run or "").startswith(_STAND_IN):
        message = f"{node.role} is in the container {node.container}, and {component.name} is no composable node"
        help = 'state the class of its component: `run component "…" package "…" gate preload`; or omit `in`'
        yield Problem(_CODE, (*path, "container"), message, help)
    if component.gate is None:
        return
    for port, topics in sorted(node.attachments.items()):
        if len(topics) > 1:
            message = f"{node.role}.{port} is attached to {len(topics)} topics; with a gate, a port has one topic"
            yield Problem(_CODE, (*path, "attachments", port), message)
