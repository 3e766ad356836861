"""Carries out a launch file as ROS 2 would, except that nodes are noted instead of started."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from midstride.lang.source import Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, ParameterFileName
from midstride.launch_files.entity import ENDINGS, Entity, NotALaunchFile, read_entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.node_elements import NodeElements
from midstride.launch_files.python_files import carried_out
from midstride.launch_files.substitutions import substituted, truth
from midstride.launch_files.values import value_of

MAX_INCLUDES: Final = 32
MAX_INCLUSIONS: Final = 1024
# They change nothing that a node does.
_IGNORED: Final = frozenset({"log", "set_ros_log_dir"})


class Interpreter(NodeElements):
    """Notes in ``system`` what the launch files start, and in ``findings`` what was left out or assumed.

    ``undeclared``: the given ``arguments`` that no launch file has declared.
    """

    def __init__(
        self, files: ReadableFiles, findings: ImportFindings, arguments: Mapping[str, str], run_python: bool = False
    ) -> None:
        super().__init__(files, findings)
        self.undeclared = dict(arguments)
        self._run_python = run_python
        self._depth = 0
        self._elements: Final[dict[str, tuple[str, Callable[[Entity, Context], None]]]] = {
            "arg": ("name default", self._arg),
            "let": ("name value", self._let),
            "group": ("scoped forwarding", self._group),
            "include": ("file", self._include),
            "push-ros-namespace": ("namespace", self._push_namespace),
            "push_ros_namespace": ("namespace", self._push_namespace),
            "set_remap": ("from to", self._set_remap),
            "set_parameter": ("name value", self._set_parameter),
            "set_parameters_from_file": ("filename", self._set_parameters_from_file),
            "set_use_sim_time": ("value", self._set_use_sim_time),
            "set_env": ("name value", self._set_env),
            "append_env": ("name value prepend separator", self._append_env),
            "unset_env": ("name", self._unset_env),
            "timer": ("period", self._timer),
            "ros_timer": ("period", self._timer),
            "node": ("", self.node),
            "lifecycle_node": ("", self.node),
            "node_container": ("", self.container),
            "load_composable_node": ("target", self.left_out),
            "executable": ("", self.executable),
        }

    def file(self, path: str, context: Context) -> None:
        """Carry out the launch file at an absolute path. Raises UnknownValue if it cannot be read."""
        if path.endswith(".py"):
            self._python(path, context)
            return
        source = self.files.source(path, *ENDINGS)
        try:
            root = read_entity(source)
        except NotALaunchFile as error:
            raise UnknownValue(f"it is not a launch file that can be read: {error}", "include") from None
        self.system.files += 1
        outer, context.file = context.file, path
        try:
            self._children(root.children, context)
        finally:
            context.file = outer

    def _python(self, path: str, context: Context) -> None:
        """Note the nodes of a launch file in Python. Raises UnknownValue."""
        span = Span(self.files.source(path, ".py"), 0, 0)
        if not self._run_python:
            message = "it is in Python, so a program; `--run-python` carries it out, where ROS's `launch` is"
            raise UnknownValue(message, "python")
        known = {name: value for name, value in context.variables.items() if isinstance(value, str)}
        found = carried_out(path, known, context.namespace, context.environment)
        self.system.files += 1
        self.undeclared.clear()  # which of them it declares is not known
        for kind, message in found["left"]:
            self.findings.add(kind, message, span)
        for node in found["nodes"]:
            self.python_node(node, span, context)

    def _children(self, entities: Sequence[Entity], context: Context) -> None:
        for entity in entities:
            self._entity(entity, context)

    def _entity(self, entity: Entity, context: Context) -> None:
        if entity.tag in _IGNORED:
            return
        if entity.tag not in self._elements:
            self.findings.add("unsupported", f"the element `{entity.tag}` is left out", entity.span)
            return
        known, function = self._elements[entity.tag]
        try:
            if not self.applies(entity, context):
                return
            if known:
                self.expect(entity, known)
            function(entity, context)
        except UnknownValue as error:
            self.findings.add(error.kind, f"`{entity.tag}` is left out: {error}", entity.span)
            if entity.tag in {"arg", "let"}:  # whether it is set is not known, so no later value may be taken for it
                name = str(entity.attributes.get("name"))
                context.variables[name] = UnknownValue(f"whether `{name}` is set is not known", error.kind)

    # -- variables -------------------------------------------------------------------------------------------

    def _arg(self, entity: Entity, context: Context) -> None:
        name = str(self.required(entity, "name"))
        self.undeclared.pop(name, None)
        if name not in context.variables:
            if "default" in entity.attributes:
                self._assign(name, entity, "default", context)
            else:
                message = f"`{name}` has no value and no default; pass `{name}:=…`"
                self.findings.add("argument", message, entity.span)
                context.variables[name] = UnknownValue(f"`{name}` has no value", "argument")
        choices = [str(self.required(choice, "value")) for choice in entity.named("choice")]
        value = context.variables[name]
        if choices and isinstance(value, str) and value not in choices:
            message = f"`{name}` is `{value}`, which is not among its choices: {', '.join(choices)}"
            self.findings.add("argument", message, entity.span)

    def _let(self, entity: Entity, context: Context) -> None:
        self._assign(self.text(entity, "name", context), entity, "value", context)

    def _assign(self, name: str, entity: Entity, attribute: str, context: Context) -> None:
        """Set a variable. That its value is not known is reported where it is needed."""
        try:
            context.variables[name] = self.text(entity, attribute, context)
        except UnknownValue as error:
            context.variables[name] = UnknownValue(f"`{name}` has no known value: {error}", error.kind)

    def _set_env(self, entity: Entity, context: Context) -> None:
        context.set_environment(self.text(entity, "name", context), self.text(entity, "value", context))

    def _append_env(self, entity: Entity, context: Context) -> None:
        name, value = self.text(entity, "name", context), self.text(entity, "value", context)
        separator = self.text(entity, "separator", context) if "separator" in entity.attributes else os.pathsep
        before = [context.environment[name]] if name in context.environment else []
        prepend = truth(self.text(entity, "prepend", context)) if "prepend" in entity.attributes else False
        context.set_environment(name, separator.join([value, *before] if prepend else [*before, value]))

    def _unset_env(self, entity: Entity, context: Context) -> None:
        name = self.text(entity, "name", context)
        context.environment = {key: value for key, value in context.environment.items() if key != name}
        context.variables_set[name] = None  # what is inherited, too

    # -- scopes ----------------------------------------------------------------------------------------------

    def _group(self, entity: Entity, context: Context) -> None:
        scoped = "scoped" not in entity.attributes or truth(self.text(entity, "scoped", context))
        forwarding = "forwarding" not in entity.attributes or truth(self.text(entity, "forwarding", context))
        kept = {self.text(each, "name", context): self.text(each, "value", context) for each in entity.named("keep")}
        inner = context.scoped(forwarding) if scoped else context
        inner.variables.update(kept)
        self._children([child for child in entity.children if child.tag != "keep"], inner)

    def _include(self, entity: Entity, context: Context) -> None:
        path = self.path(entity, "file", context)
        name = os.path.basename(path)
        given = [(self.text(each, "name", context), each) for each in entity.named("arg")]
        if self._depth >= MAX_INCLUDES or self.system.files >= MAX_INCLUSIONS:
            raise UnknownValue(f"`{name}`: launch files include too many others", "include")
        for argument, each in given:  # as in ROS, they stay set after the include
            self._assign(argument, each, "value", context)
        self._depth += 1
        try:
            self.file(path, context)
        except UnknownValue as error:
            raise UnknownValue(f"`{name}`: {error}", error.kind) from None
        finally:
            self._depth -= 1

    def _push_namespace(self, entity: Entity, context: Context) -> None:
        context.namespace = self.joined(context.namespace, self.text(entity, "namespace", context))

    def _timer(self, entity: Entity, context: Context) -> None:
        self.findings.add(
            "unsupported", f"the delay of `{entity.tag}` is left out; its nodes start at once", entity.span
        )
        self._children(entity.children, context)

    # -- what holds for nodes --------------------------------------------------------------------------------

    def _set_remap(self, entity: Entity, context: Context) -> None:
        context.remaps.append((self.text(entity, "from", context), self.text(entity, "to", context)))

    def _set_parameter(self, entity: Entity, context: Context) -> None:
        name = self.text(entity, "name", context)
        context.settings.append((name, value_of(entity, "value", lambda text: substituted(text, context))))

    def _set_parameters_from_file(self, entity: Entity, context: Context) -> None:
        context.settings.append(ParameterFileName(self.path(entity, "filename", context), None, entity.span))

    def _set_use_sim_time(self, entity: Entity, context: Context) -> None:
        context.settings.append(("use_sim_time", truth(self.text(entity, "value", context))))
