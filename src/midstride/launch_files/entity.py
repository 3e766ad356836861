"""Launch files in XML and YAML as one tree of entities with their places, as launch_xml and launch_yaml read them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias
from xml.parsers import expat

from midstride.lang.source import Source, Span
from midstride.lang.yaml_tree import InvalidYaml, Tree, read_tree

Plain: TypeAlias = "str | bool | int | float"
EntityValue: TypeAlias = "Plain | list[Plain]"

MAX_NESTING: Final = 64
YAML_ENDINGS: Final = (".yaml", ".yml")
ENDINGS: Final = (".xml", ".launch", *YAML_ENDINGS)


class NotALaunchFile(Exception):
    """The text is not a launch file. The message quotes nothing of it, as it may be any file."""


@dataclass(slots=True)
class Entity:
    """An element: its attributes, and its nested elements in order. ``typed``: values have types, as in YAML."""

    tag: str
    span: Span
    typed: bool = False
    attributes: dict[str, EntityValue] = field(default_factory=dict)
    children: list[Entity] = field(default_factory=list)

    def named(self, *tags: str) -> Iterator[Entity]:
        """The nested elements with one of these tags."""
        return (child for child in self.children if child.tag in tags)


def read_entity(source: Source) -> Entity:
    """The element `launch` of a launch file. Raises NotALaunchFile."""
    root = _from_yaml(source) if source.name.endswith(YAML_ENDINGS) else _from_xml(source)
    if root.tag != "launch":
        raise NotALaunchFile("its outermost element is not `launch`")
    return root


def _from_xml(source: Source) -> Entity:
    parser = expat.ParserCreate()
    document = Entity("", Span(source, 0, 0))
    stack = [document]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > MAX_NESTING:
            raise NotALaunchFile(f"its elements are nested more than {MAX_NESTING} deep")
        offset = source.offset(parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        entity = Entity(tag, Span(source, offset, offset + len(tag) + 1), attributes=dict(attributes))
        stack[-1].children.append(entity)
        stack.append(entity)

    def refuse(*_: Any) -> None:
        raise NotALaunchFile("it has a document type declaration")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(source.text, True)
    except expat.ExpatError as error:
        raise NotALaunchFile(f"line {error.lineno} is not valid XML: {expat.ErrorString(error.code)}") from None
    except ValueError:  # a lone surrogate
        raise NotALaunchFile("it is not valid XML") from None
    return document.children[0]


def _from_yaml(source: Source) -> Entity:
    try:
        tree = read_tree(source)
    except InvalidYaml as error:
        line = source.position(error.span.start)[0]
        raise NotALaunchFile(f"line {line} is not valid YAML, or has more than a launch file may have") from None
    value, span = tree or ({}, Span(source, 0, 0))
    if not isinstance(value, dict) or list(value) != ["launch"]:
        raise NotALaunchFile("its outermost element is not `launch`")
    if not isinstance(value["launch"][0], (list, dict, type(None))):
        raise NotALaunchFile("its element `launch` has a value instead of elements")
    return _entity("launch", value["launch"], span)


def _entity(tag: str, tree: Tree, span: Span) -> Entity:
    """``span``: of the element, if ``tree`` has none of itself."""
    value, _ = tree
    entity = Entity(tag, span, typed=True)
    if isinstance(value, list):
        entity.children = [_nested(item) for item in value]
    elif isinstance(value, dict):
        for name, (content, place) in value.items():
            if name == "children" and isinstance(content, list):
                entity.children += [_nested(item) for item in content]
            elif isinstance(content, list) and any(isinstance(item, dict) for item, _ in content):
                entity.children += [_entity(name, item, item[1]) for item in content]
            elif isinstance(content, list):
                plain = [item for item, _ in content if isinstance(item, (str, bool, int, float))]
                entity.attributes[name] = list(plain)
            elif isinstance(content, dict):
                raise NotALaunchFile(f"line {place.source.position(place.start)[0]} is not an element")
            elif content is not None:
                entity.attributes[name] = content
    return entity


def _nested(item: Tree) -> Entity:
    value, span = item
    if not isinstance(value, dict) or len(value) != 1:
        line = span.source.position(span.start)[0]
        raise NotALaunchFile(f"line {line} is not an element: a mapping with one key")
    [(tag, content)] = value.items()
    return _entity(tag, content, span)
