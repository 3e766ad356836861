"""The specification of what launch files start, in the Stride language."""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final

from midstride.lang.printer import format_text
from midstride.lang.source import Span
from midstride.lang.source_files import include_folders
from midstride.lang.token_stream import RESERVED
from midstride.launch_files.dialects import Ros
from midstride.launch_files.element_attributes import MAX_NAME
from midstride.launch_files.ending_programs import ends
from midstride.launch_files.findings import ImportFindings
from midstride.launch_files.launched_managers import with_one_manager
from midstride.launch_files.launched_nodes import LaunchedContainer, LaunchedNode, LaunchedSystem
from midstride.launch_files.launched_parameters import (
    FOR_ALL,
    LaunchedParameters,
    ParameterReader,
    written_file,
)
from midstride.launch_files.roslaunch_values import server_file
from midstride.model.component import DEFAULT_CONTAINER, ParameterValue
from midstride.model.component_rules import MAX_NUMBER
from midstride.model.lifecycle_management import Management
from midstride.model.printable import on_one_line

MAX_STRING: Final = 8000
# Longer text is not read in a specification, such as a robot's description.
MAX_INLINE: Final = 1000
_PARAMETER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
_WORD: Final = re.compile(r"[A-Za-z0-9]+")
_VARIABLE: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class SpecificationDraft:
    """The specification of what was launched, to be written to ``target`` (None: to no file).

    Once :meth:`text` has been called: ``nodes``, how many it has, and ``parameter_files``, the texts of the parameter
    files that it names for what the language cannot state, by their names.
    """

    def __init__(
        self,
        name: str,
        launched: LaunchedSystem,
        reader: ParameterReader,
        findings: ImportFindings,
        target: Path | None,
        management: Management = "manager",
        ros: Ros = 2,
    ) -> None:
        self._name = name
        self._ros = ros
        self._management = management
        self._launched = launched
        self._reader = reader
        self._findings = findings
        self._target = target
        self._folder = Path() if target is None else target.parent
        self._beside: dict[str, dict[str, ParameterValue]] = {}
        self._named: set[str] = set()
        self.nodes = 0
        self.parameter_files: dict[str, str] = {}

    def text(self, imported_from: str) -> str:
        """The specification. Paths in it are relative to its folder."""
        nodes = list(_with_own_names(self._launched.nodes, self._findings))
        parameters = {node.role: self._reader.parameters(node) for node in nodes}
        lifecycle = with_one_manager(nodes, parameters, self._management, self._findings)
        nodes = lifecycle.nodes
        self.nodes = len(nodes)
        self._reader.note_other_sections(nodes)
        bodies = {node.role: self._body(node, parameters[node.role], nodes) for node in nodes}
        names = _component_names(nodes, bodies)
        lines = [*(f"# {on_one_line(line)}" for line in self._heading(imported_from)), f"system {self._name}", ""]
        lines += [f"{line}\n" for line in self._hosts()]
        written: set[str] = set()
        for node in nodes:
            component = names[node.role]
            if component not in written:
                written.add(component)
                lines += [f"# {on_one_line(_place(node))}", f"component {component} {{", *bodies[node.role], "}", ""]
        for name, container in sorted(self._launched.containers.items()):
            lines += self._container(name, container)
        for namespace in dict.fromkeys(node.namespace for node in sorted(nodes, key=lambda node: node.namespace != "")):
            if namespace:
                word = "/" if namespace in RESERVED else ""  # as a path, it is a name
                lines.append(f"namespace {word}{namespace} {{")
            for node in nodes:
                if node.namespace == namespace:
                    stated = [*self._respawn(node), *self._values(node, parameters[node.role].replaced)]
                    block = " {\n" + "\n".join(stated) + "\n}" if stated else ""
                    inside = f" in /{node.shares}" if node.shares else ""
                    on = f" on {node.host}" if node.host else ""
                    lines.append(f"node {node.name} : {names[node.role]}{inside}{on}{block}")
            lines.append("}\n" if namespace else "")
        lines += self._order(nodes)
        lines += [f"order {_path(one)} before {_path(other)}" for one, other in lifecycle.orders]
        if self._beside:
            assert self._target is not None
            sections = (written_file(f"/{role}", values) for role, values in sorted(self._beside.items()))
            self.parameter_files[_beside(self._target)] = "".join(sections)
        self._server()
        formatted = format_text("\n".join(lines))
        assert formatted.text is not None, [str(each) for each in formatted.diagnostics]
        return formatted.text

    def _hosts(self) -> Iterator[str]:
        """The statements of the hosts on which nodes run."""
        for host in self._launched.hosts.values():
            setup = f" setup {quoted(host.setup)}" if host.setup else ""
            yield f"host {host.name} {{ ssh {quoted(host.ssh)}{setup} }}"

    def _server(self) -> None:
        """Put what no node has of ROS 1's parameter server into a file that `rosparam load` reads."""
        of_places: dict[Span, list[str]] = {}
        for name, found in self._launched.server.items():
            of_places.setdefault(found.span, []).append(name)
        where = "with `-o FILE`, a file beside FILE has them"
        if self._target is not None and of_places:
            file = _beside(self._target, kind="rosparam")
            values = {name: found.value for name, found in self._launched.server.items()}
            self.parameter_files[file] = server_file(values)
            where = f"`rosparam load {file}` sets them, before `midstride up`"
        for span, names in of_places.items():
            few = ", ".join(f"`{name}`" for name in names[:4]) + (", …" if len(names) > 4 else "")
            message = f"left out, of no node or of no type of the language: {few}; {where}"
            self._findings.add("parameters", message, span)

    def _container(self, name: str, container: LaunchedContainer) -> Iterator[str]:
        """The statement of a container that several nodes share, with how its process is started and ended."""
        program, process = container.program, container.process
        run = f"run {quoted(program.run)} package {quoted(program.package)}"
        environment: list[str] = []
        if process is not None:
            run += self._of_process(process)
            environment = list(self._environment(process))
        if environment:
            yield from (f"container /{name} {{", run, *environment, "}")
        else:
            yield f"container /{name} {{ {run} }}"

    def _of_process(self, node: LaunchedNode) -> str:
        """The clauses of `run` for what stands before a program, and for how its process is ended."""
        prefix = f" prefix {words}" if (words := quoted(shlex.join(node.prefix))) and node.prefix else ""
        if words is None:
            self._findings.add("unsupported", f"the prefix of `{node.role}` cannot be written", node.span)
        return f"{prefix} stop {' '.join(node.stop)}" if node.stop else prefix

    def _heading(self, imported_from: str) -> Iterator[str]:
        """The first comment of the file, with what it needs."""
        folder = os.path.realpath(self._folder)
        outside = [path for path in self._named if os.path.commonpath((folder, os.path.realpath(path))) != folder]
        allowed = {os.path.realpath(each): each for each in include_folders()}
        needed = {
            shown
            for real, shown in allowed.items()
            for path in outside
            if os.path.commonpath((real, os.path.realpath(path))) == real
        }
        if needed:
            options = " ".join(f"--include-path {shlex.quote(os.path.abspath(each))}" for each in sorted(needed))
            yield f"Needs files of other folders: `midstride {options} COMMAND …`"
        if self._ros == 1:
            yield f"Imported from {imported_from}, for `--backend ros1`. A launch file does not state ports: state"
            yield "those of nodes that are to be replaced without a gap."
            return
        yield f"Imported from {imported_from}. A launch file does not state ports: while the nodes run,"
        yield "`midstride capture --into FILE` adds what they publish and subscribe to."

    def _body(self, node: LaunchedNode, parameters: LaunchedParameters, nodes: Sequence[LaunchedNode]) -> list[str]:
        """The statements of the node's component, which is one of ``nodes``."""
        command = quoted(node.run())
        if command is None:
            message = f"the command of `{node.role}` cannot be written; it is `false`"
            self._findings.add("unsupported", message, node.span)
        of_package = f" package {quoted(node.package)}" if node.package and command else ""
        composable = ""
        if (container := node.container) is not None and command:
            composable = "component "
            if container != DEFAULT_CONTAINER:
                of_package += f" in {quoted(container.run)}"
            if container.package != DEFAULT_CONTAINER.package:
                of_package += f" package {quoted(container.package)}"
        process = self._of_process(node)
        gate = f"gate {node.gate} unnamed" if node.unnamed else f"gate {node.gate}"
        if ends(node):
            gate = "once unnamed" if node.unnamed else "once"
            message = f"`{node.program}` is known to end when it has done its work, so `{node.role}` is `once`"
            self._findings.add("once", message, node.span, left_out=False)
        lines = [f"run {composable}{command or quoted('false')}{of_package}{process} {gate}"]
        lines += self._environment(node)
        stated, beside = self._separated(node, parameters.values)
        written: list[str | dict[str, ParameterValue]] = []
        for statement in parameters.statements:
            if isinstance(statement, str):
                self._named.add(statement)
                lines.append(f"parameters {quoted(os.path.relpath(statement, self._folder))}")
                written.append(statement)
            else:
                for_all, long = self._separated(node, statement)
                lines += ["parameters for all {", *for_all, "}"] if for_all else []
                lines += self._file_for_all(node, long) if long else []
                own = {name: value for name, value in parameters.replaced.items() if name in long}
                beside |= self._separated(node, own)[1]
                written.append(statement)
        if beside and self._target is not None:
            lines.append(f"parameters {quoted(_beside(self._target))}")
            self._beside.setdefault(node.role, {}).update(beside)
        self._reader.note_values_for_all(node, written, nodes)
        return [*lines, "parameters {", *stated, "}"] if stated else lines

    def _file_for_all(self, node: LaunchedNode, values: Mapping[str, ParameterValue]) -> Iterator[str]:
        """The statement of a parameter file with ``values`` for all nodes of the process of ``node``, for it alone."""
        assert self._target is not None
        role = node.role.replace("/", ".")
        names = (_beside(self._target, f".{role}{number}") for number in ("", *map(str, range(2, 1000))))
        name = next(name for name in names if name not in self.parameter_files)
        self.parameter_files[name] = written_file(FOR_ALL, values)
        yield f"parameters {quoted(name)}"

    def _environment(self, node: LaunchedNode) -> Iterator[str]:
        variables = []
        for name, value in node.environment.items():
            text = None if value is None else quoted(value)
            if not _VARIABLE.fullmatch(name) or (text is None and value is not None):
                message = f"the environment variable `{name}` of `{node.role}` cannot be written"
                self._findings.add("unsupported", message, node.span)
            else:
                variables.append(f"unset {name}" if text is None else f"{name} = {text}")
        if variables:
            yield "\n".join(["environment {", *variables, "}"])

    def _separated(
        self, node: LaunchedNode, values: Mapping[str, ParameterValue]
    ) -> tuple[list[str], dict[str, ParameterValue]]:
        """The values as the language states them, and those that are stated in a parameter file beside it."""
        stated: list[str] = []
        beside: dict[str, ParameterValue] = {}
        for name, value in values.items():
            text = _value(value)
            long = isinstance(value, str) and (len(value) > MAX_INLINE or "\n" in value)
            is_name = _PARAMETER.fullmatch(name) and len(name) <= MAX_NAME
            if text is not None and is_name and (not long or self._target is None):
                stated.append(f"{name} = {text}")
            elif self._target is not None and name.isprintable():
                beside[name] = value
            else:
                remedy = "" if self._target is not None else "; with `-o FILE`, it is in a parameter file beside FILE"
                message = f"the parameter `{name}` of `{node.role}` cannot be written{remedy}"
                self._findings.add("parameters", message, node.span)
        return stated, beside

    def _values(self, node: LaunchedNode, values: Mapping[str, ParameterValue]) -> list[str]:
        """The values that replace those of files that are named, and those for all nodes of the process."""
        written = self._beside.get(node.role, {})
        stated, beside = self._separated(node, {name: value for name, value in values.items() if name not in written})
        for name in beside:
            message = (
                f"the parameter `{name}` of `{node.role}` keeps the value of its file: the other cannot be written"
            )
            self._findings.add("parameters", message, node.span)
        return ["parameters {", *stated, "}"] if stated else []

    def _respawn(self, node: LaunchedNode) -> Iterator[str]:
        """The statements on restarts, of which `respawn` is the first."""
        if (respawn := node.respawn) is None or respawn.retries == 0:  # launch does not restart it either
            return
        yield "respawn"
        if respawn.delay >= 1:  # launch waits as long each time
            yield f"respawn_delay {respawn.delay:g} s to {respawn.delay:g} s"
        elif respawn.delay > 0:
            yield f"respawn_delay {respawn.delay:g} s"
        if respawn.retries > 0:  # launch counts all of them
            yield f"respawn_max_retries {respawn.retries} in 1000000000 s"
        notes = []
        if respawn.retries < 0:
            yield "respawn_max_retries unlimited"
            launcher = "roslaunch does" if self._ros == 1 else "launch does unless a number is stated"
            notes.append(f"without end, as {launcher}; `respawn_max_retries 5` would give up")
        if respawn.delay < 1:
            notes.append(f"launch waits {respawn.delay:g} s each time, here the delay grows up to 30 s")
        if notes:
            message = f"`{node.role}` is restarted: {'; '.join(notes)}"
            self._findings.add("restart", message, node.span, left_out=False)

    def _order(self, nodes: Sequence[LaunchedNode]) -> Iterator[str]:
        """Yield the orders by which what is started later follows all that is started before it."""
        times = sorted({node.at for node in nodes})
        for before, time in pairwise(times):
            for late in (node for node in nodes if node.at == time):
                for early in (node for node in nodes if node.at == before):
                    yield f"order {_path(early)} before {_path(late)}"
        for node in nodes:
            if node.later:
                message = f"`{node.role}` is started {node.later} in launch, here once those before it have registered"
                message = f"{message}; if it needs their messages, assume them as inputs"
                if math.isinf(node.at):
                    message = f"{message}; if that program has done its work when it ends, state it `once`"
                self._findings.add("later", message, node.span, left_out=False)


def _place(node: LaunchedNode) -> str:
    return f"{os.path.basename(node.span.source.name)}:{node.span.source.position(node.span.start)[0]}"


def _path(node: LaunchedNode) -> str:
    return f"/{node.role}"


def _beside(target: Path, whose: str = "", kind: str = "parameters") -> str:
    """The name of a file beside a specification, for parameters that the language cannot state."""
    return f"{target.stem}.{kind}{whose}.yaml"


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
        renamed = replace(node, name=name, launched_role=node.role if number > 1 else "")
        used.add(renamed.role)
        if number > 1:
            why = "is a word of the Stride language" if node.name in RESERVED else "has another node already"
            findings.add("name", f"`{node.role}` {why}; this node is named `{renamed.role}`", node.span, left_out=False)
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
    return (name if name[0].isalpha() else f"Node{name}")[:MAX_NAME]


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
