"""The launch files of ROS 1: scopes and includes, as `roslaunch` has them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import RoslaunchContext
from midstride.launch_files.entity import Entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.roslaunch_grammar import NOT_LAUNCHED, check_element, refused
from midstride.launch_files.roslaunch_nodes import RoslaunchNodes


class RoslaunchInterpreter(RoslaunchNodes):
    """Carries out the launch files of ROS 1."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings, arguments: Mapping[str, str]) -> None:
        super().__init__(files, findings, arguments)
        functions: Mapping[str, Callable[[Entity, RoslaunchContext], None]] = {
            "arg": self._arg,
            "env": self.env,
            "group": self._group,
            "include": self._include,
            "machine": self.machine,
            "node": self.node,
            "param": self.param,
            "remap": self.remap,
            "rosparam": self.rosparam,
        }
        self.elements = {tag: self._checked(function) for tag, function in functions.items()}

    def _checked(
        self, function: Callable[[Entity, RoslaunchContext], None]
    ) -> Callable[[Entity, RoslaunchContext], None]:
        def carried_out(entity: Entity, context: RoslaunchContext) -> None:
            check_element(entity, self.findings)
            function(entity, context)

        return carried_out

    def main(self, path: str, context: RoslaunchContext) -> None:
        self.undeclared.pop("__ns", None)
        given = context.variables.get("__ns", context.environment.get("ROS_NAMESPACE"))
        context.namespace = self.joined("/", given) if isinstance(given, str) and given else None
        super().main(path, context)
        nodes, self.system.server = self.server.distributed(self.system.nodes, self.findings)
        self.system.nodes[:] = nodes
        self.assign_hosts(context)

    def begin(self, root: Entity, context: RoslaunchContext) -> None:
        if deprecated := root.attributes.get("deprecated"):
            self.findings.add("unsupported", f"the launch file is deprecated: {deprecated}", root.span, left_out=False)

    def unrecognized(self, entity: Entity) -> None:
        message = NOT_LAUNCHED.get(entity.tag, f"roslaunch passes over `{entity.tag}`, which it does not know")
        self.findings.add("unsupported", message, entity.span, left_out=False)

    def unknown(self, entity: Entity, context: RoslaunchContext, error: UnknownValue) -> None:
        if error.kind != "refused":
            super().unknown(entity, context, error)

    def _arg(self, entity: Entity, context: RoslaunchContext) -> None:
        name = self.text(entity, "name", context)
        if "value" in entity.attributes and "default" in entity.attributes:
            raise refused("`arg` has both `value` and `default`")
        if name in context.declared and not context.replaces:
            raise refused(f"the argument `{name}` is declared twice")
        self.undeclared.pop(name, None)
        context.declared.add(name)
        if "value" in entity.attributes:
            if name in context.variables and not context.replaces:
                raise refused(f"`{name}` has a value already, which `value` does not replace; `default` would keep it")
            self.assign(name, entity, "value", context)
        elif name not in context.variables and "default" in entity.attributes:
            self.assign(name, entity, "default", context)
        else:
            context.variables.setdefault(name, UnknownValue(f"`{name}` has no value; pass `{name}:=…`", "argument"))

    def _group(self, entity: Entity, context: RoslaunchContext) -> None:
        inner = context.inner(self.inner_namespace(entity, context))
        self.note_cleared(entity, context)
        inner.private = dict(inner.private)
        self.children(entity.children, inner)

    def _include(self, entity: Entity, context: RoslaunchContext) -> None:
        path = self.path(entity, "file", context)
        inner = context.inner(self.inner_namespace(entity, context))
        self.note_cleared(entity, context)
        inner.replaces = self.boolean(entity, "pass_all_args", context, False)
        inner.declared, inner.variables = set(), dict(context.variables) if inner.replaces else {}

        def argument(child: Entity) -> None:
            name = self.text(child, "name", context)
            if name in inner.declared:
                raise refused(f"the argument `{name}` is passed twice")
            if "value" not in child.attributes and "default" not in child.attributes:
                raise refused(f"the argument `{name}` is passed without a value")
            inner.declared.add(name)
            try:
                attribute = "value" if "value" in child.attributes else "default"
                inner.variables[name] = self.text(child, attribute, context)
            except UnknownValue as error:
                inner.variables[name] = UnknownValue(f"`{name}` has no known value: {error}", error.kind)

        self.parts(entity, context, {"arg": argument, "env": lambda child: self.env(child, inner)})
        passed, inner.declared = inner.declared, set()
        self.include(path, inner)
        if not inner.replaces:
            for name in sorted(passed - inner.declared):
                self.findings.refuse(f"`{os.path.basename(path)}` declares no argument `{name}`", entity.span)
