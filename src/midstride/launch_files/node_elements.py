"""The elements of launch files that start processes: nodes, containers of components, other programs."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from midstride.ament_index import prefixes
from midstride.lang.source import Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, ParametersGiven
from midstride.launch_files.ending_programs import ends
from midstride.launch_files.entity import Entity
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.interpreter import stem
from midstride.launch_files.launch_grammar import text_of
from midstride.launch_files.launched_containers import Containers, left_out
from midstride.launch_files.launched_nodes import LaunchedNode, LaunchedRespawn, LoadedNode
from midstride.launch_files.launched_parameters import written_file
from midstride.launch_files.node_attributes import NodeAttributes
from midstride.launch_files.ros_arguments import split_ros_arguments, words_of
from midstride.launch_files.substitutions import performed
from midstride.model.component import DEFAULT_CONTAINER
from midstride.model.load_words import extra_argument

# Where launch writes what a process prints, which changes nothing that a node does.
_OUTPUTS: Final = ("screen", "log", "both", "own_log", "full")


class NodeElements(NodeAttributes):
    """Notes the processes that launch files of ROS 2 start.

    ``later``: why what is met now is started after the others, and how long after them (s), if it is. ``containers``:
    what becomes of composable nodes.
    """

    def __init__(
        self,
        files: ReadableFiles,
        findings: ImportFindings,
        arguments: Mapping[str, str],
        containers: Containers = "keep",
    ) -> None:
        super().__init__(files, findings, arguments)
        self._containers = containers
        self.later: tuple[str, float] | None = None

    # -- what starts a process -------------------------------------------------------------------------------

    def node(self, entity: Entity, context: Context) -> None:
        """Raises UnknownValue."""
        program = self.text(entity, "exec", context)
        package = self.text(entity, "pkg", context) if "pkg" in entity.attributes else ""
        self.check_package(package, program, entity.span, context)
        stated = self.text(entity, "name", context) if "name" in entity.attributes else None
        own = self.text(entity, "namespace", context) if "namespace" in entity.attributes else None
        namespace = self.joined(context.namespace, own)
        words = self.words(entity, "args", context)
        if "ros_args" in entity.attributes:
            words += ["--ros-args", *self.words(entity, "ros_args", context)]
        arguments, ros = split_ros_arguments(words)
        named = ros.name or stated or None  # the first rule for a name applies, and arguments come first
        node = LaunchedNode(
            name=self.node_name(named, stem(program), entity.span),
            namespace=self.namespace(ros.namespace if ros.namespace is not None else namespace),
            program=stem(program),
            command=(program, *arguments),
            span=entity.span,
            remaps=(*ros.remaps, *context.remaps, *self.remaps(entity, context)),
            ros_arguments=tuple(ros.others),
            package=package,
            gate=_gate(state := "unconfigured" if entity.tag == "lifecycle_node" else ""),
            state=state,
            unnamed=named is None,
        )
        section = f"{namespace.rstrip('/')}/{stated}" if stated and namespace is not None else "/**"
        settings = [
            *self.given_by_arguments(ros, entity.span),
            *context.settings,
            *self.settings(entity, section, context),
        ]
        self._note(entity, context, replace(node, settings=tuple(settings)))

    def executable(self, entity: Entity, context: Context) -> None:
        """Any program. Raises UnknownValue."""
        words = words_of(text_of(entity, "cmd"), lambda template: performed(template, context))
        label = self.text(entity, "name", context) if "name" in entity.attributes else ""
        self._note(entity, context, self._program(words, label, entity.span, context))

    def _program(self, words: Sequence[str], label: str, span: Span, context: Context) -> LaunchedNode:
        """A program of which the launch file does not say that it is a node. Raises UnknownValue."""
        command, ros = split_ros_arguments(words)
        if not command or not command[0]:
            raise UnknownValue("it has no command", "unsupported")
        package, command = self._in_package(command, context)
        script = (number for number, word in enumerate(command) if number and not word.startswith("-"))
        last = next(script, 0) if "python" in command[0] else 0
        # One word with blanks is for a shell.
        program = stem(command[last] if len(command) > 1 else command[last].split(maxsplit=1)[0])
        name = self.node_name(ros.name or label or program, program, span)
        what = shlex.join(command[: last + 1])
        known = f"the node `{name}`" if ros.name else f"the node of `{name}`, which names itself"
        node = LaunchedNode(
            name=name,
            namespace=self.namespace(ros.namespace),
            program=program,
            command=tuple(command),
            span=span,
            remaps=tuple(ros.remaps),
            settings=tuple(self.given_by_arguments(ros, span)),
            ros_arguments=tuple(ros.others),
            package=package,
            unnamed=ros.name is None,  # the label is launch's own, and the program is not passed it
        )
        if not ends(node):
            message = f"`{what}` is started as {known}; remove it if it does not take ROS's arguments"
            self.findings.add("program", message, span, left_out=False)
        return node

    def _in_package(self, command: list[str], context: Context) -> tuple[str, list[str]]:
        """The package of a program that is named by its path, or run by `ros2 run`, and the rest of the command."""
        if command[:2] == ["ros2", "run"] and len(command) > 3 and not command[2].startswith("-"):
            self.check_package(command[2], command[3], None, context)
            return command[2], command[3:]
        for prefix in prefixes(context.environment):
            folder = os.path.join(prefix, "lib", "")
            package, _, program = command[0].removeprefix(folder).partition("/")
            if command[0].startswith(folder) and program and "/" not in program and package in context.packages:
                return package, [program, *command[1:]]
        return "", command

    def python_process(self, found: Mapping[str, Any], span: Span, context: Context) -> None:
        """A process of a launch file in Python, as the process that carried it out has described it."""
        try:
            if found["type"]:
                node = self._python_node(found, span, context)
            else:
                node = self._program(found["words"], found["label"], span, context)
        except UnknownValue as error:
            self.findings.add(error.kind, f"a process in Python is left out: {error}", span)
            return
        environment = {**context.variables_set, **found["environment"]}
        if found["cleared"]:
            environment = {name: value for name, value in environment.items() if value is not None}
            message = f"`{node.role}` keeps the other variables of its environment, of which `env` would clear it"
            self.findings.add("unsupported", message, span)
        respawn = found["respawn"]
        self._add(
            replace(
                node,
                environment=environment,
                prefix=tuple(found["prefix"]),
                respawn=None if respawn is None else LaunchedRespawn(respawn["delay"], respawn["retries"]),
                stop=tuple(f"{name} {seconds:g} s" for name, seconds in sorted(found["stop"].items(), reverse=True)),
            ),
            found["folder"],
            found["shell"],
        )

    def python_component(self, found: Mapping[str, Any], span: Span, context: Context) -> None:
        """A composable node of a launch file in Python, as launch would have it loaded."""
        if self._containers == "omit":
            self.findings.add("composable", left_out(found["plugin"]), span)
            return
        settings = []
        section = _section(found["namespace"], found["name"])
        for kind, value in found["parameters"]:
            if kind == "path" and value not in found["texts"]:
                settings.append(ParametersGiven(span, path=value))
            else:
                text = found["texts"][value] if kind == "path" else written_file(section, value)
                settings.append(ParametersGiven(span, text=text))
        try:
            node = self._loaded(
                found["package"],
                found["plugin"],
                found["name"] or None,
                found["namespace"] or None,
                tuple((old, new) for old, new in found["remaps"]),
                settings,
                self._extra(found["extra"].items(), span),
                span,
                context,
            )
            self._add_loaded(node, found["target"])
        except UnknownValue as error:
            self.findings.leave_out(f"the component `{found['plugin']}`", error, span)

    def _python_node(self, found: Mapping[str, Any], span: Span, context: Context) -> LaunchedNode:
        package, program = found["package"], found["executable"]
        self.check_package(package, program, span, context)
        arguments, ros = split_ros_arguments(found["words"][1:])
        settings = []
        for given in self.given_by_arguments(ros, span):
            text = found["texts"].get(given.path)
            settings.append(given if text is None else ParametersGiven(span, text=text))
        return LaunchedNode(
            name=self.node_name(ros.name, stem(program), span),
            namespace=self.namespace(ros.namespace),
            program=stem(program),
            command=(program, *arguments),
            span=span,
            remaps=tuple(ros.remaps),
            settings=tuple(settings),
            ros_arguments=tuple(ros.others),
            unnamed=ros.name is None,
            package=package,
            gate=_gate(found.get("state", "")),
            state=found.get("state", ""),
        )

    def container(self, entity: Entity, context: Context) -> None:
        """Raises UnknownValue."""
        self.node(entity, context)
        self._load(entity, f"/{self.system.nodes[-1].role}", context)

    def load(self, entity: Entity, context: Context) -> None:
        """Raises UnknownValue."""
        target = self.text(entity, "target", context)
        self._load(entity, target if target.startswith("/") else self.joined(context.namespace, target), context)

    def _load(self, entity: Entity, target: str | None, context: Context) -> None:
        """Note the composable nodes that are in the element."""
        for component in entity.named("composable_node"):
            label = str(component.attributes.get("plugin", "a component"))
            try:
                applies = self.applies(component, context)
                if applies and self._containers != "omit":
                    self._add_loaded(self._composable(component, context), target or "")
            except UnknownValue as error:
                applies = self._containers == "omit"  # also what it would be is left out
                if not applies:
                    self.findings.leave_out(f"the component `{shortened(label)}`", error, component.span)
            if applies and self._containers == "omit":
                self.findings.add("composable", left_out(label), component.span)

    def _composable(self, entity: Entity, context: Context) -> LaunchedNode:
        """Raises UnknownValue."""
        package, plugin = self.text(entity, "pkg", context), self.text(entity, "plugin", context)
        stated = self.text(entity, "name", context) if "name" in entity.attributes else None
        own = self.text(entity, "namespace", context) if "namespace" in entity.attributes else None
        namespace = self.joined(context.namespace, own)
        extra = [
            (self.text(each, "name", context), self.text(each, "value", context)) for each in entity.named("extra_arg")
        ]
        return self._loaded(
            package,
            plugin,
            stated,
            namespace,
            (*context.remaps, *self.remaps(entity, context)),
            [*context.settings, *self.settings(entity, _section(namespace, stated), context)],
            self._extra(extra, entity.span),
            entity.span,
            context,
        )

    def _extra(self, stated: Iterable[tuple[str, object]], span: Span) -> list[str]:
        """The extra arguments that a `run` text can state (``NAME:=VALUE``); the others are left out."""
        found = []
        for name, value in stated:
            word = f"{name}:={_in_words(value)}"
            try:
                extra_argument(word)
            except ValueError as error:
                self.findings.add("unsupported", f"the extra argument `{name}` is left out: {error}", span)
            else:
                found.append(word)
        return found

    def _loaded(
        self,
        package: str,
        plugin: str,
        name: str | None,
        namespace: str | None,
        remaps: tuple[tuple[str, str], ...],
        settings: Sequence[ParametersGiven],
        extra: Sequence[str],
        span: Span,
        context: Context,
    ) -> LaunchedNode:
        """A composable node. Raises UnknownValue."""
        if package not in context.packages:
            self.findings.add_once("package", f"package `{package}` is not here", span)
        of_class = plugin.rpartition("::")[2]
        if not name:
            name = "_".join(word.lower() for word in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])", of_class)) or "node"
            message = f"the component `{plugin}` has no name here, so its class gives it one; it is named `{name}`"
            self.findings.add("name", message, span, left_out=False)
        return LaunchedNode(
            name=self.node_name(name, of_class, span),
            namespace=self.namespace(namespace),
            program=of_class,
            command=(plugin,),
            span=span,
            remaps=remaps,
            settings=tuple(settings),
            package=package,
            container=DEFAULT_CONTAINER,
            extra=tuple(extra),
        )

    def _add_loaded(self, node: LaunchedNode, target: str) -> None:
        if self.later is not None:
            how, at = self.later
            node = replace(node, later=how, at=at)
        self.system.loaded.append(LoadedNode(node, self.joined("/", target) or "/"))

    def _note(self, entity: Entity, context: Context, node: LaunchedNode) -> None:
        """Add the node, with what every process may have."""
        folder = self.text(entity, "cwd", context) if "cwd" in entity.attributes else None
        shell = self.flag(entity, "shell", False)
        if "on_exit" in entity.attributes:
            self.findings.add("unsupported", f"the attribute `on_exit` of `{entity.tag}` is left out", entity.span)
        if "output" in entity.attributes and (output := self.text(entity, "output", context)) not in _OUTPUTS:
            message = f"launch does not start it: `output` is `{shortened(output)}`, and can be {', '.join(_OUTPUTS)}"
            self.findings.add("refused", message, entity.span, left_out=False)
        variables = dict(context.variables_set)
        for variable in entity.named("env"):
            try:
                variables[self.variable_name(variable, context)] = self.text(variable, "value", context)
            except UnknownValue as error:
                self.findings.leave_out("an environment variable", error, variable.span)
        self._add(
            replace(
                node,
                environment=variables,
                prefix=tuple(self.prefix(entity, node, context)),
                respawn=self.respawn(entity, context),
                stop=tuple(self.stop(entity, context)),
            ),
            folder,
            shell,
        )

    def _add(self, node: LaunchedNode, folder: str | None, shell: bool) -> None:
        if shell:
            words = [node.run()] if node.package else [" ".join(node.command)]
            node = replace(node, command=("sh", "-c", *words), package="", program=node.program)
        if folder:
            node = replace(node, prefix=("env", f"--chdir={folder}", *node.prefix))
        if self.later is not None:
            how, at = self.later
            node = replace(node, later=how, at=at)
        self.system.nodes.append(node)


def _gate(state: str) -> str:
    """The gate of a node whose lifecycle has a ``state``, or that has none: Midstride manages it unless others do."""
    return "lifecycle preload" if state else "preload"


def _section(namespace: str | None, name: str | None) -> str:
    """The section of a parameter file for one node; for all of its process where its name is not known."""
    return f"{(namespace or '').rstrip('/')}/{name}" if name else "/**"


def _in_words(value: object) -> str:
    """The value of an extra argument, as `ros2 component load` reads it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
