"""Launch files in XML and YAML as one tree of entities with their places, as launch_xml and launch_yaml read them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias
from xml.parsers import expat

from midstride.errors import NOT_OF_TAG
from midstride.lang.source import Source, Span

Plain: TypeAlias = "str | bool | int | float"
# A value of a YAML document, with its place.
Tree: TypeAlias = "tuple[dict[str, Tree] | list[Tree] | Plain | None, Span]"
EntityValue: TypeAlias = "Plain | list[Plain]"

MAX_NESTING: Final = 64
MAX_VALUES: Final = 50_000
YAML_ENDINGS: Final = (".yaml", ".yml")
ENDINGS: Final = (".xml", ".launch", *YAML_ENDINGS)


class NotALaunchFile(Exception):
    """The text is not a launch file. The message quotes nothing of it, as it may be any file."""


@dataclass(slots=True)
class Entity:
    """An element: its attributes, and its nested elements in order. ``typed``: values have types, as in YAML.

    There, an element may be a list of nested ones, or have them in ``children`` (``has_children``), or have a value
    instead of either; and some are ``listed`` under a key of their own. ``text``: what an element of XML has in it
    beside nested elements.
    """

    tag: str
    span: Span
    typed: bool = False
    attributes: dict[str, EntityValue] = field(default_factory=dict)
    children: list[Entity] = field(default_factory=list)
    form: Literal["element", "mapping", "list", "value"] = "element"
    has_children: bool = False
    listed: bool = False
    text: str = ""

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

    def text(data: str) -> None:
        stack[-1].text += data

    def refuse(*_: Any) -> None:
        raise NotALaunchFile("it has a document type declaration")

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.CharacterDataHandler = text
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
    value, span = _tree(source)
    if not isinstance(value, dict) or list(value) != ["launch"]:
        raise NotALaunchFile("its outermost element is not `launch`")
    if not isinstance(value["launch"][0], (list, dict, type(None))):
        raise NotALaunchFile("its element `launch` has a value instead of elements")
    root = _entity("launch", value["launch"], span)
    root.children = [child for child in root.children if not child.listed]  # which launch does not read
    return root


def _tree(source: Source) -> Tree:
    """The document as PyYAML reads it, with the place of each value. Raises NotALaunchFile."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    count = 0

    def tree(node: Any, depth: int, loader: Any) -> Tree:
        nonlocal count
        count += 1
        if count > MAX_VALUES or depth > MAX_NESTING:  # aliases may repeat values without end
            raise NotALaunchFile("it has more than a launch file may have")
        start = source.offset(node.start_mark.line + 1, node.start_mark.column + 1)
        span = Span(source, start, start + 1)
        if isinstance(node, yaml.SequenceNode):
            return [tree(each, depth + 1, loader) for each in node.value], span
        if isinstance(node, yaml.MappingNode):
            loader.flatten_mapping(node)
            pairs = [(loader.construct_object(key, deep=True), value) for key, value in node.value]
            return {str(key): tree(value, depth + 1, loader) for key, value in pairs}, span
        value = loader.construct_object(node)
        if not isinstance(value, (str, bool, int, float, type(None))):
            raise NotALaunchFile(f"line {node.start_mark.line + 1} has a value that launch does not take")
        return value, span

    loader = None
    try:
        loader = yaml.SafeLoader(source.text)
        root = loader.get_single_node()
        return ({}, Span(source, 0, 0)) if root is None else tree(root, 0, loader)
    except (yaml.YAMLError, *NOT_OF_TAG) as error:
        mark = getattr(error, "problem_mark", None)
        where = "it" if mark is None else f"line {mark.line + 1}"
        raise NotALaunchFile(f"{where} is not valid YAML") from None
    finally:
        if loader is not None:
            loader.dispose()


def _entity(tag: str, tree: Tree, span: Span) -> Entity:
    """``span``: of the element, if ``tree`` has none of itself."""
    value, _ = tree
    entity = Entity(tag, span, typed=True, form="value")
    if isinstance(value, list):
        entity.form, entity.has_children = "list", True
        entity.children = [_nested(item) for item in value]
    elif isinstance(value, dict):
        entity.form = "mapping"
        for name, (content, place) in value.items():
            if name == "children" and isinstance(content, list):
                entity.has_children = True
                entity.children += [_nested(item) for item in content]
            elif isinstance(content, list) and any(isinstance(item, dict) for item, _ in content):
                listed = [_entity(name, item, item[1]) for item in content]
                for each in listed:
                    each.listed = True
                entity.children += listed
            elif isinstance(content, list):
                plain = [item for item, _ in content if isinstance(item, (str, bool, int, float))]
                entity.attributes[name] = list(plain)
            elif isinstance(content, dict):
                raise NotALaunchFile(f"line {place.source.position(place.start)[0]} is not an element")
            elif content is None:
                line = place.source.position(place.start)[0]
                raise NotALaunchFile(f"line {line} has a key without a value, which launch does not take")
            else:
                entity.attributes[name] = content
    return entity


def _nested(item: Tree) -> Entity:
    value, span = item
    if not isinstance(value, dict) or len(value) != 1:
        line = span.source.position(span.start)[0]
        raise NotALaunchFile(f"line {line} is not an element: a mapping with one key")
    [(tag, content)] = value.items()
    return _entity(tag, content, span)
