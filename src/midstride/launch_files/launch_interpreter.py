"""The launch files of ROS 2: their elements, as `launch` carries them out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from midstride.lang.source import Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, ParametersGiven
from midstride.launch_files.entity import ENDINGS, Entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launch_grammar import check_grammar, text_of
from midstride.launch_files.launched_containers import Containers
from midstride.launch_files.node_elements import NodeElements
from midstride.launch_files.python_files import carried_out
from midstride.launch_files.values import value_of_text


class LaunchInterpreter(NodeElements):
    """Carries out the launch files of ROS 2. With ``run_python``, also those in Python, which are programs."""

    ros = 2
    endings = (*ENDINGS, ".py")
    setting = ("arg", "let")

    def __init__(
        self,
        files: ReadableFiles,
        findings: ImportFindings,
        arguments: Mapping[str, str],
        run_python: bool = False,
        containers: Containers = "keep",
    ) -> None:
        super().__init__(files, findings, arguments, containers)
        self._given = dict(arguments)
        self._run_python = run_python
        # What timers start: when (s), how that is said, the elements, and their launch file.
        self._postponed: list[tuple[float, str, Sequence[Entity], str]] = []
        self._stated: set[str] = set()
        self.elements = {
            "arg": self._arg,
            "let": self._let,
            "group": self._group,
            "include": self._include,
            "push-ros-namespace": self._push_namespace,
            "push_ros_namespace": self._push_namespace,
            "set_remap": self._set_remap,
            "set_parameter": self._set_parameter,
            "set_parameters_from_file": self._set_parameters_from_file,
            "set_use_sim_time": self._set_use_sim_time,
            "set_env": self._set_env,
            "append_env": self._append_env,
            "unset_env": self._unset_env,
            "reset_env": self._reset_env,
            "reset": self._reset,
            "timer": self._timer,
            "ros_timer": self._timer,
            "shutdown": self._shutdown,
            "node": self.node,
            "lifecycle_node": self.node,
            "node_container": self.container,
            "load_composable_node": self.load,
            "executable": self.executable,
        }

    def main(self, path: str, context: Context) -> None:
        super().main(path, context)
        while self._postponed:
            self._postponed.sort(key=lambda each: each[0])
            time, how, elements, context.file = self._postponed.pop(0)
            self.later = how, time  # launch has left all groups by then
            self.children(elements, context)
        context.file = path

    def file(self, path: str, context: Context) -> None:
        if path.endswith(".py"):
            self._python(path, context)
        else:
            super().file(path, context)

    def begin(self, root: Entity, context: Context) -> None:
        check_grammar(root, self.findings)
        if self.depth > 0:
            self._check_arguments(root, context)

    def _check_arguments(self, root: Entity, context: Context) -> None:
        """Launch refuses an include that states no value for an argument without default, even if it is set outside."""
        for entity in root.named("arg"):
            name = entity.attributes.get("name")
            conditional = "if" in entity.attributes or "unless" in entity.attributes
            if "default" in entity.attributes or conditional or name in self._stated:
                continue
            if name in context.variables:
                message = f"launch refuses this include: it has no `<arg>` for `{name}`, which is set outside only"
                self.findings.add("argument", message, entity.span, left_out=False)

    def _python(self, path: str, context: Context) -> None:
        """Note what a launch file in Python starts, and take over what it sets. Raises UnknownValue."""
        span = Span(self.files.source(path, ".py"), 0, 0)
        if not self._run_python:
            message = "it is in Python, so a program; `--run-python` carries it out, where ROS's `launch` is"
            raise UnknownValue(message, "python")
        known = {name: value for name, value in context.variables.items() if isinstance(value, str)}
        rules = [
            setting.path if setting.rule is None else list(setting.rule.split(":=", 1)) for setting in context.settings
        ]
        given = {
            "variables": known,
            "arguments": sorted(self._given) if self.depth == 0 else sorted(self._stated),
            "namespace": context.namespace,
            "remaps": context.remaps,
            "parameters": rules,
        }
        context.trace.current = path
        found = carried_out(path, given, context.environment)
        self.system.files += found["files"]
        for name in found["declared"]:
            self.undeclared.pop(name, None)
        for kind, message, file, line in found["left"]:
            add = self.findings.add_once if kind == "package" else self.findings.add
            add(kind, message, self._at(file, line, span))
        for process in found["processes"]:
            later, after = self.later, process["after"]
            if after is not None:
                self.later = after["how"], float("inf") if after["time"] is None else after["time"]
            file, line = process["place"]
            note = self.python_component if "plugin" in process else self.python_process
            note(process, self._at(file, line, span), context)
            self.later = later
        self._take_over(found["state"], known, rules, span, context)

    def _take_over(
        self, state: Mapping[str, Any], known: Mapping[str, str], rules: Sequence[Any], span: Span, context: Context
    ) -> None:
        """Have what a launch file in Python has set hold for what follows, as after any include."""
        for name in known:
            if name not in state["variables"]:
                del context.variables[name]
        context.variables.update(
            {name: value for name, value in state["variables"].items() if known.get(name) != value}
        )
        context.namespace = state["namespace"]
        remaps = [(old, new) for old, new in state["remaps"]]
        context.remaps[:] = remaps  # in place: it may be shared with the scopes around
        kept = next(
            (n for n, (old, new) in enumerate(zip(rules, state["parameters"], strict=False)) if old != new), len(rules)
        )
        context.settings[kept:] = [
            ParametersGiven(span, path=os.path.abspath(each))
            if isinstance(each, str)
            else ParametersGiven(span, rule=f"{each[0]}:={each[1]}")
            for each in state["parameters"][kept:]
        ]
        for name, value in state["environment"].items():
            context.set_environment(name, value)

    def _at(self, file: str, line: int, otherwise: Span) -> Span:
        """A line of a launch file in Python, or of what it includes."""
        try:
            source = self.files.source(file)
        except UnknownValue:
            return otherwise
        offset = source.offset(max(line, 1), 1)
        return Span(source, offset, offset)

    def after(self, entity: Entity, context: Context) -> None:
        for name in dict.fromkeys(context.trace.differing):
            message = f"`$({name})` after an include is that of the included file in launch up to 3.7; not so here"
            self.findings.add("include", message, entity.span, left_out=False)
        context.trace.differing.clear()

    # -- variables -------------------------------------------------------------------------------------------

    def _arg(self, entity: Entity, context: Context) -> None:
        name = text_of(entity, "name")
        self.undeclared.pop(name, None)
        if name not in context.variables:
            if "default" in entity.attributes:
                self.assign(name, entity, "default", context)
            else:
                message = f"`{name}` has no value and no default; pass `{name}:=…`"
                self.findings.add("argument", message, entity.span)
                context.variables[name] = UnknownValue(f"`{name}` has no value", "argument")
        choices = [text_of(choice, "value") for choice in entity.named("choice")]
        value = context.variables[name]
        if choices and isinstance(value, str) and value not in choices:
            message = f"`{name}` is `{value}`, which is not among its choices: {', '.join(choices)}"
            self.findings.add("argument", message, entity.span)

    def _let(self, entity: Entity, context: Context) -> None:
        self.assign(self.text(entity, "name", context), entity, "value", context)

    def _set_env(self, entity: Entity, context: Context) -> None:
        context.set_environment(self.variable_name(entity, context), self.text(entity, "value", context))

    def _append_env(self, entity: Entity, context: Context) -> None:
        name, value = self.variable_name(entity, context), self.text(entity, "value", context)
        separator = self.text(entity, "separator", context) if "separator" in entity.attributes else os.pathsep
        before = [context.environment[name]] if name in context.environment else []
        prepend = self.boolean(entity, "prepend", context, False)
        context.set_environment(name, separator.join([value, *before] if prepend else [*before, value]))

    def _unset_env(self, entity: Entity, context: Context) -> None:
        context.set_environment(self.text(entity, "name", context), None)

    def _reset_env(self, entity: Entity, context: Context) -> None:
        context.reset_environment()

    def _kept(self, entity: Entity, context: Context) -> dict[str, str | UnknownValue]:
        return {self.text(each, "name", context): self.text(each, "value", context) for each in entity.named("keep")}

    def _reset(self, entity: Entity, context: Context) -> None:
        kept = self._kept(entity, context)
        context.forget()
        context.variables.update(kept)

    # -- scopes ----------------------------------------------------------------------------------------------

    def _group(self, entity: Entity, context: Context) -> None:
        scoped = self.flag(entity, "scoped", True)
        kept = self._kept(entity, context)
        inner = context.scoped(self.flag(entity, "forwarding", True)) if scoped else context
        inner.variables.update(kept)
        self.children([child for child in entity.children if child.tag != "keep"], inner)

    def _include(self, entity: Entity, context: Context) -> None:
        path = self.path(entity, "file", context)
        given = [(self.text(each, "name", context), each) for each in entity.named("arg", "let")]
        for argument, each in given:  # as in ROS, they stay set after the include
            self.assign(argument, each, "value", context)
        outer, self._stated = self._stated, {argument for argument, _ in given}
        try:
            self.include(path, context)
        finally:
            self._stated = outer

    def _push_namespace(self, entity: Entity, context: Context) -> None:
        context.namespace = self.joined(context.namespace, self.text(entity, "namespace", context))

    def _timer(self, entity: Entity, context: Context) -> None:
        stated = entity.attributes.get("period")
        text = str(stated) if isinstance(stated, (int, float)) else self.text(entity, "period", context)
        try:
            period = float(text)
        except ValueError:
            raise UnknownValue("its `period` is not a number", "unsupported") from None
        now = 0.0 if self.later is None else self.later[1]
        self._postponed.append((now + period, f"{now + period:g} s later", entity.children, context.file))

    def _shutdown(self, entity: Entity, context: Context) -> None:
        self.findings.add("unsupported", "`shutdown` is left out: it would end all that was started", entity.span)

    # -- what holds for nodes --------------------------------------------------------------------------------

    def _set_remap(self, entity: Entity, context: Context) -> None:
        context.remaps.append((self.text(entity, "from", context), self.text(entity, "to", context)))

    def _set_parameter(self, entity: Entity, context: Context) -> None:
        value = value_of_text(self.text(entity, "value", context))
        text = str(tuple(value) if isinstance(value, list) else value)  # as launch_ros passes it
        rule = f"{self.text(entity, 'name', context)}:={text}"
        context.settings.append(ParametersGiven(entity.span, rule=rule))

    def _set_parameters_from_file(self, entity: Entity, context: Context) -> None:
        context.settings.append(ParametersGiven(entity.span, path=self.path(entity, "filename", context)))

    def _set_use_sim_time(self, entity: Entity, context: Context) -> None:
        message = (
            "`set_use_sim_time` sets the time of launch's own node, and of no other; it is left out. For all nodes: "
        )
        self.findings.add("unsupported", f'{message}`<set_parameter name="use_sim_time" value="true"/>`', entity.span)
