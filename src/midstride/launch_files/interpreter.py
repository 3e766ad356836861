"""Carries out launch files as ROS would, but notes processes instead of starting them: what both dialects share."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Final, Generic, TypeVar

from midstride.lang.source import Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context
from midstride.launch_files.dialects import Ros, require_dialect
from midstride.launch_files.element_attributes import MAX_NAME, ElementAttributes
from midstride.launch_files.entity import ENDINGS, Entity, NotALaunchFile, read_entity
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launch_grammar import text_of
from midstride.launch_files.launched_nodes import LaunchedSystem

MAX_INCLUDES: Final = 32
MAX_INCLUSIONS: Final = 1024
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")

Scope = TypeVar("Scope", bound=Context)


class Interpreter(ElementAttributes, Generic[Scope]):
    """Notes in ``system`` what the launch files start, and in ``findings`` what was left out or assumed.

    ``undeclared``: the given ``arguments`` that no launch file has declared. ``elements``: how each element of the
    dialect is carried out. ``endings``: of the names of launch files. ``setting``: the elements that set a variable.
    """

    ros: ClassVar[Ros]
    endings: ClassVar[Sequence[str]] = ENDINGS
    setting: ClassVar[Sequence[str]] = ("arg",)

    def __init__(self, files: ReadableFiles, findings: ImportFindings, arguments: Mapping[str, str]) -> None:
        super().__init__(files, findings)
        self.system = LaunchedSystem()
        self.undeclared = dict(arguments)
        self.elements: Mapping[str, Callable[[Entity, Scope], None]] = {}
        self.depth = 0

    def main(self, path: str, context: Scope) -> None:
        """Carry out the launch file at an absolute path, and what it starts later. Raises UnknownValue."""
        self.file(path, context)

    def file(self, path: str, context: Scope) -> None:
        """Carry out the launch file at an absolute path. Raises UnknownValue if it cannot be read."""
        source = self.files.source(path, *self.endings)
        try:
            root = read_entity(source)
        except NotALaunchFile as error:
            raise UnknownValue(f"it is not a launch file that can be read: {error}", "include") from None
        if self.depth > 0:
            require_dialect(root, self.ros)
        self.system.files += 1
        self.begin(root, context)
        outer, context.file = context.file, path
        context.trace.current = path
        try:
            self.children(root.children, context)
        finally:
            context.file = outer

    def begin(self, root: Entity, context: Scope) -> None:
        """Check a launch file before any of it is carried out."""

    def include(self, path: str, context: Scope) -> None:
        """Carry out a launch file that another one includes. Raises UnknownValue with its name."""
        name = os.path.basename(path)
        if self.depth >= MAX_INCLUDES or self.system.files >= MAX_INCLUSIONS:
            raise UnknownValue(f"`{name}`: launch files include too many others", "include")
        self.depth += 1
        try:
            self.file(path, context)
        except UnknownValue as error:
            raise UnknownValue(f"`{name}`: {error}", error.kind) from None
        finally:
            self.depth -= 1

    def children(self, entities: Sequence[Entity], context: Scope) -> None:
        """Carry out elements in their order; what one has no value for is left out."""
        for entity in entities:
            function = self.elements.get(entity.tag)
            if function is None:
                self.unrecognized(entity)
                continue
            try:
                if self.applies(entity, context):
                    function(entity, context)
                    self.after(entity, context)
            except UnknownValue as error:
                self.findings.leave_out(f"`{entity.tag}`", error, entity.span)
                self.unknown(entity, context, error)

    def unrecognized(self, entity: Entity) -> None:
        """Note an element that is not carried out: it changes nothing that a node does, or is refused."""

    def after(self, entity: Entity, context: Scope) -> None:
        """Note what is only known once an element has been carried out."""

    def unknown(self, entity: Entity, context: Scope, error: UnknownValue) -> None:
        """Have what an element would set not be taken for known: it has been left out because of ``error``."""
        if entity.tag in self.setting:
            name = str(entity.attributes.get("name"))
            context.variables[name] = UnknownValue(f"whether `{name}` is set is not known", error.kind)

    def assign(self, name: str, entity: Entity, attribute: str, context: Context) -> None:
        """Set a variable to the value of an attribute. That this is not known is reported where it is needed."""
        text_of(entity, attribute)
        try:
            context.variables[name] = self.text(entity, attribute, context)
        except UnknownValue as error:
            context.variables[name] = UnknownValue(f"`{name}` has no known value: {error}", error.kind)

    def check_package(self, package: str, program: str, span: Span | None, context: Scope) -> None:
        """Name a package that is not here, or that has no such program."""
        if not package or span is None:
            return
        if package not in context.packages:
            self.findings.add_once("package", f"package `{package}` is not here", span)
        elif context.packages.is_installed(package):
            try:
                context.packages.executable(package, program)
            except UnknownValue as error:
                self.findings.add("package", str(error), span, left_out=False)

    def node_name(self, stated: str | None, program: str, span: Span) -> str:
        """The name of a node, which its program gives it where none is ``stated``; with the characters of a name."""
        text = program if stated is None else stated
        name = _NOT_IN_NAMES.sub("_", text)[:MAX_NAME]
        name = name if name[:1].isalpha() or name[:1] == "_" else f"node_{name}"
        if stated is None:
            message = f"the node has no name here, so its program gives it one; the specification calls it `{name}`"
            self.findings.add("name", message, span, left_out=False)
        elif name != text:
            self.findings.add("name", f"`{text}` is not the name of a node; it is named `{name}`", span, left_out=False)
        return name


def stem(path: str) -> str:
    """The name of a file without its ending."""
    return os.path.splitext(os.path.basename(path))[0]
