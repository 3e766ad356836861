"""The elements of launch files that start processes: nodes, containers of components, other programs."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Final

from midstride.lang.source import Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, ParameterFileName, Setting
from midstride.launch_files.entity import Entity, EntityValue
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launched_nodes import LaunchedNode, LaunchedSystem
from midstride.launch_files.substitutions import substituted, truth
from midstride.launch_files.values import plain, value_of
from midstride.model.component_rules import MAX_NUMBER

# Attributes that every element may have, and those that change nothing that a node does.
_ANYWHERE: Final = "if unless description output output_format emulate_tty exec_name"
_PROCESS: Final = "launch-prefix respawn respawn_delay respawn_max_retries sigterm_timeout sigkill_timeout"
_NODE: Final = f"pkg exec name namespace args ros_args {_PROCESS}"
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")
_COMPONENTS: Final = ("composable_node",)


class NodeElements:
    """Notes nodes in ``system``, and in ``findings`` what was left out or assumed."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings) -> None:
        self.files = files
        self.findings = findings
        self.system = LaunchedSystem()

    def node(self, entity: Entity, context: Context) -> None:
        """Raises UnknownValue."""
        self.expect(entity, _NODE)
        program = self.text(entity, "exec", context)
        package = self.text(entity, "pkg", context) if "pkg" in entity.attributes else ""
        self._check_package(package, entity.span, context)
        stated = self.text(entity, "name", context) if "name" in entity.attributes else None
        name = self._name(stated, _stem(program), entity.span)
        namespace = self.text(entity, "namespace", context) if "namespace" in entity.attributes else ""
        self._note(entity, context, name, self.joined(context.namespace, namespace), _stem(program), [program], package)

    def python_node(self, found: Mapping[str, Any], span: Span, context: Context) -> None:
        """A node of a launch file in Python, as its process has described it."""
        package, program = found["package"], found["executable"]
        self._check_package(package, span, context)
        folder = os.path.dirname(span.source.path or span.source.name)
        settings = [ParameterFileName(os.path.join(folder, path), text, span) for path, text in found["parameters"]]
        self.system.nodes.append(
            LaunchedNode(
                name=self._name(found["name"] or None, _stem(program), span),
                namespace=found["namespace"],
                program=_stem(program),
                command=(program, *found["arguments"]),
                span=span,
                remaps=(*context.remaps, *((old, new) for old, new in found["remaps"])),
                settings=(*context.settings, *settings),
                environment=dict(context.variables_set),
                package=package,
                stop=tuple(f"{name} {seconds:g} s" for name, seconds in found["stop"].items()),
                gate="lifecycle" if found["lifecycle"] else "preload",
            )
        )

    def executable(self, entity: Entity, context: Context) -> None:
        """Any program. Raises UnknownValue."""
        self.expect(entity, f"cmd name {_PROCESS}")
        command = _split(self.text(entity, "cmd", context))
        if not command:
            raise UnknownValue("it has no command", "unsupported")
        script = (number for number, word in enumerate(command) if number and not word.startswith("-"))
        last = next(script, 0) if "python" in command[0] else 0
        program = _stem(command[last])
        stated = self.text(entity, "name", context) if "name" in entity.attributes else program
        name = self._name(stated, program, entity.span)
        what = shlex.join(command[: last + 1])
        message = f"`{what}` is started as the node `{name}`; remove it if it does not take ROS's arguments"
        self.findings.add("program", message, entity.span)
        self._note(entity, context, name, context.namespace, program, command)

    def container(self, entity: Entity, context: Context) -> None:
        """Raises UnknownValue."""
        self.node(entity, context)
        self.left_out(entity, context)

    def left_out(self, entity: Entity, context: Context) -> None:
        """Note the components that are in the element, or would be loaded by it."""
        for component in entity.named(*_COMPONENTS):
            label = str(component.attributes.get("plugin", "a component"))
            try:
                applies = self.applies(component, context)
            except UnknownValue:
                applies = True
            if applies:
                message = f"the component `{label}` is left out: it would share the process of its container"
                self.findings.add("composable", message, component.span)

    def _note(
        self,
        entity: Entity,
        context: Context,
        name: str,
        namespace: str,
        program: str,
        command: list[str],
        package: str = "",
    ) -> None:
        prefix, args = (self._words(entity, each, context) for each in ("launch-prefix", "args"))
        self.system.nodes.append(
            LaunchedNode(
                name=name,
                namespace=namespace,
                program=program,
                command=(*command, *args),
                span=entity.span,
                remaps=(*context.remaps, *self._remaps(entity, context)),
                settings=(*context.settings, *self._settings(entity, "", context)),
                environment=dict(self._environment(entity, context)),
                ros_arguments=self._words(entity, "ros_args", context),
                respawn=tuple(self._respawn(entity, context)),
                stop=tuple(self._stop(entity, context)),
                package=package,
                prefix=prefix,
                gate="lifecycle" if entity.tag == "lifecycle_node" else "preload",
            )
        )
        for child in entity.children:
            if child.tag not in {"param", "remap", "env", *_COMPONENTS}:
                self.findings.add("unsupported", f"the element `{child.tag}` in a node is left out", child.span)

    def _words(self, entity: Entity, attribute: str, context: Context) -> tuple[str, ...]:
        try:
            return tuple(_split(self.text(entity, attribute, context))) if attribute in entity.attributes else ()
        except UnknownValue as error:
            self.findings.add(error.kind, f"`{attribute}` of a node is left out: {error}", entity.span)
            return ()

    def _environment(self, entity: Entity, context: Context) -> Iterator[tuple[str, str | None]]:
        variables: list[tuple[str, str | None, Span]] = [
            (name, value, entity.span) for name, value in context.variables_set.items()
        ]
        for variable in entity.named("env"):
            try:
                name = self.text(variable, "name", context)
                variables.append((name, self.text(variable, "value", context), variable.span))
            except UnknownValue as error:
                self.findings.add(error.kind, f"an environment variable is left out: {error}", variable.span)
        for name, value, span in variables:
            if name != "LD_PRELOAD":
                yield name, value
            elif value:
                message = "`LD_PRELOAD` is left out: the library with the gate is loaded by it"
                self.findings.add("unsupported", message, span)

    def _respawn(self, entity: Entity, context: Context) -> Iterator[str]:
        """The statements on restarts, of which `respawn` is the first."""
        if "respawn" in entity.attributes and truth(self.text(entity, "respawn", context)):
            yield "respawn"
            if (delay := self._number(entity, "respawn_delay", context)) is not None:
                yield f"respawn_delay {delay:g} s"
            retries = self._number(entity, "respawn_max_retries", context)
            if retries is not None and retries >= 1:
                yield f"respawn_max_retries {int(retries)}"

    def _stop(self, entity: Entity, context: Context) -> Iterator[str]:
        """How the process is ended: what of `stop` is stated, by the element or for the whole launch."""
        for name in ("sigterm", "sigkill"):
            seconds = self._number(entity, f"{name}_timeout", context)
            if seconds is None:
                seconds = _seconds(context.variables.get(f"{name}_timeout"))
            if seconds is not None:
                yield f"{name} {seconds:g} s"

    def _number(self, entity: Entity, attribute: str, context: Context) -> float | None:
        """A number from 0 that the language has, if the node states one."""
        if attribute not in entity.attributes:
            return None
        try:
            text = self.text(entity, attribute, context)
            with suppress(ValueError):
                if 0 <= (found := float(text)) <= MAX_NUMBER:
                    return found
            raise UnknownValue(f"`{shortened(text)}` is not a number from 0", "unsupported")
        except UnknownValue as error:
            self.findings.add(error.kind, f"`{attribute}` of a node is left out: {error}", entity.span)
            return None

    def _remaps(self, entity: Entity, context: Context) -> Iterator[tuple[str, str]]:
        for remap in entity.named("remap"):
            try:
                self.expect(remap, "from to")
                yield self.text(remap, "from", context), self.text(remap, "to", context)
            except UnknownValue as error:
                self.findings.add(error.kind, f"a remapping is left out: {error}", remap.span)

    def _settings(self, entity: Entity, prefix: str, context: Context) -> Iterator[Setting]:
        """Of the parameters in an element; their names begin with ``prefix``."""
        for parameter in entity.named("param"):
            yield from self._parameter(parameter, prefix, context)

    def _parameter(self, entity: Entity, prefix: str, context: Context) -> Iterator[Setting]:
        try:
            self.expect(entity, "name value type from allow_substs")
            if "from" in entity.attributes:
                path = self.path(entity, "from", context)
                replaced = "allow_substs" in entity.attributes and truth(self.text(entity, "allow_substs", context))
                text = substituted(self.files.source(path, ".yaml", ".yml").text, context) if replaced else None
                yield ParameterFileName(path, text, entity.span)
                return
            name = prefix + self.text(entity, "name", context)
            yield from self._settings(entity, f"{name}.", context)
            if not any(entity.named("param")):
                yield name, value_of(entity, "value", lambda text: substituted(text, context))
        except UnknownValue as error:
            what = entity.attributes.get("name", entity.attributes.get("from", ""))
            message = f"the parameter or file `{what}` is left out: {error}"
            self.findings.add(error.kind if error.kind != "include" else "parameters", message, entity.span)

    # -- attributes ------------------------------------------------------------------------------------------

    def expect(self, entity: Entity, known: str) -> None:
        """Note each attribute that is not among the ``known`` ones."""
        allowed = {*known.split(), *_ANYWHERE.split()}
        for name in entity.attributes:
            if name not in allowed and not name.endswith("-sep"):
                message = f"the attribute `{name}` of `{entity.tag}` is left out"
                self.findings.add("unsupported", message, entity.span)

    def applies(self, entity: Entity, context: Context) -> bool:
        """Whether the conditions of the element hold. Raises UnknownValue."""
        for attribute, wanted in (("if", True), ("unless", False)):
            if attribute in entity.attributes:
                try:
                    value = truth(self.text(entity, attribute, context))
                except UnknownValue as error:
                    raise UnknownValue(
                        f"its condition `{attribute}` has no known value: {error}", "condition"
                    ) from None
                if value is not wanted:
                    return False
        return True

    def required(self, entity: Entity, attribute: str) -> EntityValue:
        """Raises UnknownValue."""
        if attribute not in entity.attributes:
            raise UnknownValue(f"`{entity.tag}` has no `{attribute}`", "unsupported")
        return entity.attributes[attribute]

    def text(self, entity: Entity, attribute: str, context: Context) -> str:
        """The value of an attribute, with its substitutions carried out. Raises UnknownValue."""
        return substituted(plain(self.required(entity, attribute)), context)

    def path(self, entity: Entity, attribute: str, context: Context) -> str:
        """The same as an absolute path, relative to the launch file. Raises UnknownValue."""
        text = self.text(entity, attribute, context)
        if not text or "\0" in text:
            raise UnknownValue("this is not a file name", "include")
        return os.path.normpath(os.path.join(os.path.dirname(context.file), text))

    def joined(self, namespace: str, more: str) -> str:
        """``more`` in ``namespace``; one that starts with a slash is absolute. Raises UnknownValue."""
        found = (more if more.startswith("/") else f"{namespace}/{more}").strip("/")
        if found and not all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", part) for part in found.split("/")):
            raise UnknownValue(f"`{found}` is not a namespace", "name")
        return found

    def _check_package(self, package: str, span: Span, context: Context) -> None:
        if package and package not in context.packages:
            self.findings.add("package", f"package `{package}` is not here", span)

    def _name(self, stated: str | None, program: str, span: Span) -> str:
        """The name of a node, which its program gives it where none is ``stated``; with the characters of a name."""
        text = program if stated is None else stated
        name = _NOT_IN_NAMES.sub("_", text)
        name = name if name[:1].isalpha() or name[:1] == "_" else f"node_{name}"
        if stated is None:
            message = f"the node has no name here, so its program gives it one; it is started as `{name}`"
            self.findings.add("name", message, span)
        elif name != text:
            self.findings.add("name", f"`{text}` is not the name of a node; it is named `{name}`", span)
        return name


def _seconds(text: object) -> float | None:
    """A number from 0 that the language has; None where ``text`` is none."""
    with suppress(ValueError):
        if isinstance(text, str) and 0 <= (found := float(text)) <= MAX_NUMBER:
            return found
    return None


def _stem(path: str) -> str:
    return os.path.splitext(os.path.basename(path))[0]


def _split(text: str) -> list[str]:
    """Raises UnknownValue."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise UnknownValue(f"a command cannot be split into words: {error}", "unsupported") from None
