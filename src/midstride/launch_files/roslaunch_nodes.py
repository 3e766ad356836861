"""The elements of launch files of ROS 1 that start processes, or say where."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import RoslaunchContext, Stated
from midstride.launch_files.element_attributes import command_words
from midstride.launch_files.entity import Entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.interpreter import stem
from midstride.launch_files.launched_nodes import LaunchedNode, LaunchedRespawn
from midstride.launch_files.roslaunch_grammar import BEFORE_FUERTE, LEGAL_NAME, refused
from midstride.launch_files.roslaunch_machines import SSH_PORT, Machine, Machines
from midstride.launch_files.roslaunch_parameters import RoslaunchParameters
from midstride.launch_files.roslaunch_values import canonical

_OUTPUTS: Final = ("screen", "log")
_FOLDERS: Final = ("node", "ROS_HOME", "ros_home")
# What Midstride states itself.
_OWN: Final = ("__name:=", "__ns:=")
_DEFAULTS: Final = ("true", "false", "never")


class RoslaunchNodes(RoslaunchParameters):
    """Notes the processes that launch files of ROS 1 start, and the machines on which."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings, arguments: Mapping[str, str]) -> None:
        super().__init__(files, findings, arguments)
        self._declared: list[tuple[Machine, Entity]] = []
        self._default_machine = ""

    def node(self, entity: Entity, context: RoslaunchContext) -> None:
        """Raises UnknownValue."""
        package, program, stated = (self.text(entity, each, context) for each in ("pkg", "type", "name"))
        if not package.strip() or not program.strip() or not stated or "/" in stated:
            raise refused("`pkg`, `type` or `name` of `node` is empty, or the name has a namespace")
        self.check_package(package, program, entity.span, context)
        self.note_cleared(entity, context)
        namespace = self.inner_namespace(entity, context)
        name = self.node_name(stated, stem(program), entity.span)
        machine = self.optional(entity, "machine", context) or self._default_machine
        own = self._parts_of(entity, context, namespace, name)
        words = self._words(entity, "args", context)
        remaps = (f"{old}:={new}" for old, new in own.remaps)
        given = (word.removeprefix("__ns:=") for word in words if word.startswith("__ns:="))
        node = LaunchedNode(
            name=name,
            namespace=self.namespace(next(given, namespace)),
            program=stem(program),
            command=("rosrun", package, program, *(word for word in words if not word.startswith(_OWN)), *remaps),
            span=entity.span,
            environment=own.variables_set,
            prefix=(*self._folder(entity, context, machine), *self._words(entity, "launch-prefix", context)),
            respawn=self._respawn(entity, context),
            gate="relay",
            host=machine,
        )
        if any(other.role == node.role for other in self.system.nodes):
            self.findings.refuse(f"several nodes are named `/{node.role}`", entity.span)
        output = self.optional(entity, "output", context) or "log"
        if output not in _OUTPUTS:
            self.findings.refuse(f"`output` is `{output}`, and can be {' or '.join(_OUTPUTS)}", entity.span)
        self.system.nodes.append(node)

    def _parts_of(
        self, entity: Entity, context: RoslaunchContext, namespace: str | None, name: str
    ) -> RoslaunchContext:
        """The scope of a node, with what is in its element. Its parameters are set: `param` counts for more than
        `rosparam`, and what is in the element more than what is private in the scope around it."""
        own = context.inner(context.namespace)
        private = context.inner(f"{(namespace or '/').rstrip('/')}/{name}")
        parameters = dict(context.private)

        def param(child: Entity) -> None:
            key, value = self.named_value(child, context)
            parameters.pop(f"~{key.lstrip('~')}", None)
            parameters[f"~{key.lstrip('~')}"] = Stated(value, child.span)

        functions = {
            "env": lambda child: self.env(child, own),
            "remap": lambda child: self.remap(child, own),
            "param": param,
            "rosparam": lambda child: self.rosparam(child, private),
        }
        self.parts(entity, context, functions)
        for key, stated in parameters.items():
            self.server.set(f"{private.namespace}/{key.lstrip('~')}", stated.value, stated.span)
        return own

    def env(self, entity: Entity, context: RoslaunchContext) -> None:
        """A variable of the processes that follow; `$(env …)` does not have it. Raises UnknownValue."""
        context.variables_set[self.variable_name(entity, context)] = self.text(entity, "value", context)

    def remap(self, entity: Entity, context: RoslaunchContext) -> None:
        """Raises UnknownValue."""
        old, new = (canonical(self.text(entity, attribute, context)) for attribute in ("from", "to"))
        for name in (old, new):
            if not LEGAL_NAME.fullmatch(name):
                raise refused(f"`{name}` of `remap` is no name")
        context.add_remap(old, new)

    def _words(self, entity: Entity, attribute: str, context: RoslaunchContext) -> list[str]:
        """The words of a command, which is split after its substitutions; none where it is not known."""
        try:
            return command_words(self.optional(entity, attribute, context))
        except UnknownValue as error:
            self.findings.leave_out(f"`{attribute}` of a node", error, entity.span)
            return []

    def _folder(self, entity: Entity, context: RoslaunchContext, machine: str) -> list[str]:
        """The words before a program that change its folder. Raises UnknownValue."""
        stated = self.optional(entity, "cwd", context)
        if stated and stated not in _FOLDERS:
            raise refused(f"`cwd` is `{stated}`, and can be node or ROS_HOME")
        try:
            if stated and machine:
                raise UnknownValue(f"that is a folder of the machine `{machine}`", "host")
            if stated == "node":
                program = context.packages.executable(*(self.text(entity, each, context) for each in ("pkg", "type")))
                return ["env", f"--chdir={os.path.dirname(program)}"]
        except UnknownValue as error:
            self.findings.leave_out("`cwd` of a node", error, entity.span)
            return []
        if stated and "ROS_HOME" in context.environment:
            return ["env", f"--chdir={context.environment['ROS_HOME']}"]
        message = "programs start in the folder of the specification, and not in ROS_HOME (~/.ros) as by roslaunch"
        self.findings.add_once("unsupported", message, entity.span)
        return []

    def _respawn(self, entity: Entity, context: RoslaunchContext) -> LaunchedRespawn | None:
        """Raises UnknownValue."""
        respawn, required = (self.boolean(entity, each, context, False) for each in ("respawn", "required"))
        if respawn and required:
            raise refused("it has both `respawn` and `required`")
        if required:
            message = "`required` is left out: roslaunch ends everything when this node ends"
            self.findings.add("unsupported", message, entity.span)
        stated = self.optional(entity, "respawn_delay", context) or "0"
        try:
            delay = float(stated)
        except ValueError:
            raise refused(f"`respawn_delay` is `{stated}`, and no number") from None
        return LaunchedRespawn(max(delay, 0.0), -1) if respawn else None

    # -- machines --------------------------------------------------------------------------------------------

    def machine(self, entity: Entity, context: RoslaunchContext) -> None:
        """Raises UnknownValue."""
        for attribute in BEFORE_FUERTE:
            if attribute in entity.attributes:
                raise refused(f"`{attribute}` of `machine`: since ROS Fuerte, `env-loader` sets the environment")
        if any(entity.named("env")):
            raise refused("`env` in `machine`: since ROS Fuerte, `env-loader` sets the environment")
        port, default = self.optional(entity, "ssh-port", context), self.optional(entity, "default", context).lower()
        if port and not port.isdigit():
            raise refused(f"`ssh-port` is `{port}`, and no number")
        if default and default not in _DEFAULTS:
            raise refused(f"`default` of `machine` is `{default}`, and can be {', '.join(_DEFAULTS)}")
        name, address = (self.text(entity, each, context) for each in ("name", "address"))
        loader = self.optional(entity, "env-loader", context) or None
        user = self.optional(entity, "user", context)
        machine = Machine(name, address, user, loader, int(port or SSH_PORT))
        for attribute, reason in (("password", "SSH keys replace it"), ("timeout", "Midstride has its own")):
            if attribute in entity.attributes:
                self.findings.add("host", f"`{attribute}` of the machine `{name}` is left out: {reason}", entity.span)
        self._declared.append((machine, entity))
        if default == "true":
            self._default_machine = name

    def assign_hosts(self, context: RoslaunchContext) -> None:
        """Have each node run on the host that its machine becomes: any that the launch files state, at any place."""
        machines = Machines(self.findings, context.environment, context.read)
        for machine, entity in self._declared:
            try:
                machines.declare(machine, entity.span)
            except UnknownValue as error:
                self.findings.leave_out("`machine`", error, entity.span)
        nodes = self.system.nodes
        nodes[:] = [replace(node, host=machines.host_of(node.host, node.span)) for node in nodes]
        self.system.hosts.update(machines.hosts)
