"""The specification of what launch files start, in the Stride language."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

from midstride.lang.printer import format_text
from midstride.lang.token_stream import RESERVED
from midstride.launch_files.findings import ImportFindings
from midstride.launch_files.launched_nodes import LaunchedNode, LaunchedSystem
from midstride.launch_files.launched_parameters import LaunchedParameters, ParameterReader
from midstride.model.component import ParameterValue
from midstride.model.component_rules import MAX_NUMBER

MAX_STRING: Final = 8000
_PARAMETER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
_WORD: Final = re.compile(r"[A-Za-z0-9]+")


def specification(
    name: str,
    launched: LaunchedSystem,
    reader: ParameterReader,
    findings: ImportFindings,
    folder: str,
    heading: str,
) -> str:
    """The text of the system ``name``. Paths in it are relative to ``folder``; ``heading`` is its first comment."""
    nodes = list(_with_own_names(launched.nodes, findings))
    bodies = {node.role: _body(node, reader.parameters(node), findings, folder) for node in nodes}
    names = _component_names(nodes, bodies)
    lines = [*(f"# {line}" for line in heading.splitlines()), f"system {name}", ""]
    written: set[str] = set()
    for node in nodes:
        component = names[node.role]
        if component not in written:
            written.add(component)
            place = f"{os.path.basename(node.span.source.name)}:{node.span.source.position(node.span.start)[0]}"
            lines += [f"# {place}", f"component {component} {{", *bodies[node.role], "}", ""]
    for namespace in dict.fromkeys(node.namespace for node in sorted(nodes, key=lambda node: node.namespace != "")):
        if namespace:
            word = "/" if namespace in RESERVED else ""  # as a path, it is a name
            lines.append(f"namespace {word}{namespace} {{")
        for node in nodes:
            if node.namespace == namespace:
                respawn = " {\n" + "\n".join(node.respawn) + "\n}" if node.respawn else ""
                lines.append(f"node {node.name} : {names[node.role]}{respawn}")
        lines.append("}\n" if namespace else "")
    formatted = format_text("\n".join(lines))
    assert formatted.text is not None, [str(each) for each in formatted.diagnostics]
    return formatted.text


def system_name(path: str) -> str:
    """The name of the system of a launch file."""
    stem = os.path.basename(path).partition(".")[0]
    words = "_".join(_WORD.findall(stem.replace("_launch", ""))) or "system"
    name = words if words[0].isalpha() else f"system_{words}"
    return f"{name}_1" if name in RESERVED else name


def _with_own_names(nodes: Iterable[LaunchedNode], findings: ImportFindings) -> Iterable[LaunchedNode]:
    """The nodes, each with a name that no other node has and that is not a word of the language."""
    used: set[str] = set()
    for node in nodes:
        name, number = node.name, 1
        while replace(node, name=name).role in used or name in RESERVED:
            number += 1
            name = f"{node.name}_{number}"
        renamed = replace(node, name=name)
        used.add(renamed.role)
        if number > 1:
            why = "is a word of the Stride language" if node.name in RESERVED else "has another node already"
            findings.add("name", f"`{node.role}` {why}; this node is named `{renamed.role}`", node.span)
        yield renamed


def _component_names(nodes: Sequence[LaunchedNode], bodies: dict[str, list[str]]) -> dict[str, str]:
    """The component of each role: nodes that run the same with the same parameters share one."""
    of_program: dict[str, set[tuple[str, ...]]] = {}
    for node in nodes:
        of_program.setdefault(node.program, set()).add(tuple(bodies[node.role]))
    of_body: dict[tuple[str, ...], str] = {}
    used: set[str] = set()
    names = {}
    for node in nodes:
        body = tuple(bodies[node.role])
        if body not in of_body:
            base = _camel(node.program if len(of_program[node.program]) == 1 else node.name)
            name, number = base, 1
            while name in used:
                number += 1
                name = f"{base}{number}"
            used.add(name)
            of_body[body] = name
        names[node.role] = of_body[body]
    return names


def _camel(text: str) -> str:
    name = "".join(word[0].upper() + word[1:] for word in _WORD.findall(text)) or "Node"
    return name if name[0].isalpha() else f"Node{name}"


def _body(node: LaunchedNode, parameters: LaunchedParameters, findings: ImportFindings, folder: str) -> list[str]:
    """The statements of the node's component."""
    values, more = [], []
    for name, value in parameters.values.items():
        text = _value(value)
        if text is None:
            findings.add("parameters", f"the parameter `{name}` of `{node.role}` cannot be written", node.span)
        elif _PARAMETER.fullmatch(name):
            values.append(f"{name} = {text}")
        else:  # not a name in the language, but one in ROS
            more += ["-p", f"{name}:={text}"]
    run, package = node.run(more)
    command = quoted(run)
    if command is None:
        findings.add("unsupported", f"the command of `{node.role}` cannot be written; it is `false`", node.span)
    of_package = f" package {quoted(package)}" if package and command else ""
    stop = f" stop {' '.join(node.stop)}" if node.stop else ""
    lines = [f"run {command or quoted('false')}{of_package}{stop} gate {node.gate}"]
    lines += [f"parameters {quoted(os.path.relpath(path, folder))}" for path in parameters.files]
    return [*lines, "parameters {", *values, "}"] if values else lines


def quoted(text: str) -> str | None:
    """``text`` as a string of the language; None if it cannot be one."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
    return f'"{escaped}"' if escaped.isprintable() and len(escaped) <= MAX_STRING else None


def _value(value: ParameterValue) -> str | None:
    """``value`` in the language; None if it cannot be written."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        members = [_value(each) for each in value]
        return None if None in members else f"[{', '.join(str(each) for each in members)}]"
    if isinstance(value, str):
        return quoted(value)
    if math.isnan(value) or math.isinf(value):
        return str(value)
    return repr(value) if abs(value) <= MAX_NUMBER else None
