"""The parameters in launch files of ROS 1: the elements `param` and `rosparam`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context, RoslaunchContext, Stated
from midstride.launch_files.entity import Entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.interpreter import Interpreter
from midstride.launch_files.launch_grammar import text_of
from midstride.launch_files.roslaunch_grammar import check_element, refused
from midstride.launch_files.roslaunch_server import ParameterServer
from midstride.launch_files.roslaunch_substitutions import resolved
from midstride.launch_files.roslaunch_values import below_name, canonical, converted, read_yaml
from midstride.launch_files.substitutions import command_output

_SOURCES: Final = ("value", "textfile", "binfile", "command")
_ANONYMOUS: Final = re.compile(r"\$\([^)]*\banon\b")


class RoslaunchParameters(Interpreter[RoslaunchContext]):
    """Reads attributes as roslaunch does, and notes in ``server`` the parameters that it sets."""

    ros = 1
    endings = ()  # any

    def __init__(self, files: ReadableFiles, findings: ImportFindings, arguments: Mapping[str, str]) -> None:
        super().__init__(files, findings, arguments)
        self.server = ParameterServer()

    # -- attributes ------------------------------------------------------------------------------------------

    def substituted(self, text: str, context: Context) -> str:
        return resolved(text, context)

    def text(self, entity: Entity, attribute: str, context: Context) -> str:
        return self._noted(text_of(entity, attribute), entity, context)

    def _noted(self, text: str, entity: Entity, context: Context) -> str:
        """``text`` with its substitutions carried out; what is only assumed of these is named. Raises UnknownValue."""
        if _ANONYMOUS.search(text):
            message = "`$(anon …)` is another name at each launch, and always the same here"
            self.findings.add("name", message, entity.span, left_out=False)
        return self.substituted(text, context)

    def optional(self, entity: Entity, attribute: str, context: Context) -> str:
        """The value of an attribute; empty where it is not stated. Raises UnknownValue."""
        return self.text(entity, attribute, context) if attribute in entity.attributes else ""

    def boolean(self, entity: Entity, attribute: str, context: Context, otherwise: bool) -> bool:
        text = self.text(entity, attribute, context) if attribute in entity.attributes else str(otherwise)
        if text.lower() not in {"true", "false"}:
            raise refused(f"`{attribute}` is `{text}`, and neither true nor false")
        return text.lower() == "true"

    def inner_namespace(self, entity: Entity, context: RoslaunchContext) -> str | None:
        """The namespace in an element. Raises UnknownValue."""
        if "ns" not in entity.attributes:
            return context.namespace
        stated = canonical(self.text(entity, "ns", context))
        if not stated:
            raise refused(f"`ns` of `{entity.tag}` is empty")
        return self.joined(context.namespace, stated)

    def note_cleared(self, entity: Entity, context: RoslaunchContext) -> None:
        """Name what an element would delete on the server. Raises UnknownValue."""
        if "clear_params" not in entity.attributes or not self.boolean(entity, "clear_params", context, False):
            return
        if entity.tag != "node" and "ns" not in entity.attributes:
            raise refused("`clear_params` without `ns`")
        message = "`clear_params` is left out: here what others have set on the server stays there"
        self.findings.add("parameters", message, entity.span, left_out=False)

    # -- elements --------------------------------------------------------------------------------------------

    def param(self, entity: Entity, context: RoslaunchContext) -> None:
        """A parameter for the nodes that follow, where it is private, or one of the server. Raises UnknownValue."""
        name, value = self.named_value(entity, context)
        if name.startswith("~"):
            context.private.pop(name, None)
            context.private[name] = Stated(value, entity.span)
        else:
            self.server.set(below_name(context.namespace or "/", name), value, entity.span)

    def named_value(self, entity: Entity, context: RoslaunchContext) -> tuple[str, Any]:
        """The name and the value that a `param` states. Raises UnknownValue."""
        kind = str(entity.attributes.get("type") or "auto").lower().strip()
        stated = [name for name in _SOURCES if name in entity.attributes]
        if len(stated) != 1:
            raise refused(f"`param` has {' and '.join(stated) or 'no value'}: it has one of {', '.join(_SOURCES)}")
        name = canonical(self.text(entity, "name", context).strip())
        if not name:
            raise refused("the name of a `param` is empty")
        text = self.text(entity, stated[0], context)
        match stated[0]:
            case "value":
                return name, converted(text.strip(), kind)
            case "textfile":
                return name, converted(self._content(entity, "textfile", context), kind)
            case "command":
                return name, converted(command_output(text, context, "`command`", False)[0], kind)
        raise UnknownValue(f"`{name}` is binary, which no parameter here is", "parameters")

    def rosparam(self, entity: Entity, context: RoslaunchContext) -> None:
        """Parameters in YAML, below the namespace of ``context``. Raises UnknownValue."""
        command = self.optional(entity, "command", context) or "load"
        if command not in {"load", "dump", "delete"}:
            raise refused(f"`command` of `rosparam` is `{command}`, and neither load nor dump nor delete")
        if command != "load":
            raise UnknownValue(f"`rosparam {command}` would change or save what is on the server before", "parameters")
        below = below_name(self.optional(entity, "ns", context), self.optional(entity, "param", context))
        name = below_name(context.namespace or "/", below) if below else context.namespace or "/"
        if name.startswith("~"):
            raise UnknownValue(f"`{name}` would be a private parameter of roslaunch itself", "parameters")
        from_file = "file" in entity.attributes
        text = self._content(entity, "file", context) if from_file else entity.text
        if self.boolean(entity, "subst_value", context, False):
            text = self._noted(text, entity, context)
        loaded = read_yaml(text)
        loaded = {} if loaded is None else loaded
        if not below and not isinstance(loaded, dict):
            raise refused("a `rosparam` without `param` has no mapping")
        self.server.set(name, loaded, entity.span)

    def _content(self, entity: Entity, attribute: str, context: RoslaunchContext) -> str:
        """The text of a file that an attribute names. Raises UnknownValue."""
        try:
            return self.files.source(self.path(entity, attribute, context)).text
        except UnknownValue as error:
            kind = "parameters" if error.kind == "include" else error.kind
            raise UnknownValue(f"`{entity.attributes[attribute]}`: {error}", kind) from None

    def parts(self, entity: Entity, context: RoslaunchContext, functions: dict[str, Callable[[Entity], None]]) -> None:
        """Carry out the elements in an element; what one has no value for is left out."""
        for child in entity.children:
            if child.tag not in functions:
                continue
            try:
                check_element(child, self.findings)
                if self.applies(child, context):
                    functions[child.tag](child)
            except UnknownValue as error:
                self.findings.leave_out(f"`{child.tag}`", error, child.span)
