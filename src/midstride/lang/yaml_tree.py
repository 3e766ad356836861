"""YAML as a tree of values with their places. It is parsed event by event, which limits nesting and aliases.

Launch files are YAML as PyYAML reads it. Parameter files are not: see :mod:`midstride.lang.rcl_parameters`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, Final, TypeAlias

from midstride.lang.source import Source, Span
from midstride.model.component import canonical
from midstride.model.contract import Scalar

MAX_DEPTH: Final = 32
MAX_VALUES: Final = 50_000

_TRUE: Final = frozenset("true True TRUE yes Yes YES on On ON".split())
_FALSE: Final = frozenset("false False FALSE no No NO off Off OFF".split())
_INTEGER: Final = re.compile(r"[-+]?(0[xX](?P<hex>[0-9a-fA-F]+)|0(?P<octal>[0-7]+)|0|[1-9][0-9]*)")
_REAL: Final = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
# The tags that say what an event of each kind is anyway, and that a scalar is a string, which ROS reads as well.
_TAGS: Final = {
    "MappingStartEvent": "tag:yaml.org,2002:map",
    "SequenceStartEvent": "tag:yaml.org,2002:seq",
    "ScalarEvent": "tag:yaml.org,2002:str",
}
_NOT_FINITE: Final = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class InvalidYaml(Exception):
    """The text at ``span`` is not valid YAML, or not what is expected there."""

    def __init__(self, span: Span, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.span = span
        self.help = help


# A value of the file with its span: a mapping, a list or a scalar.
Tree: TypeAlias = "tuple[dict[str, Tree] | list[Tree] | Scalar | None, Span]"


def read_tree(source: Source) -> Tree | None:
    """The value of a YAML document; None if it is empty. Raises InvalidYaml."""
    return _TreeBuilder(source).build(events(source))


def events(source: Source) -> Iterator[Any]:
    """PyYAML's events. Raises InvalidYaml where the text is not YAML."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        yield from yaml.parse(source.text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = error.problem or error.context or "it cannot be parsed"
        offset = 0 if mark is None else source.offset(mark.line + 1, mark.column + 1)
        message = f"invalid YAML: {reason}"
        raise InvalidYaml(Span(source, offset, offset), message, "indent with spaces, not tabs") from None
    except (yaml.YAMLError, UnicodeEncodeError):  # a character that no YAML contains, or a lone surrogate
        match = yaml.reader.Reader.NON_PRINTABLE.search(source.text)
        start, end = match.span() if match else (0, 0)
        message = f"invalid YAML: it contains {source.text[start:end]!a}" if match else "invalid YAML"
        raise InvalidYaml(Span(source, start, end), message, "write it in double quotes, escaped") from None


def span_of(source: Source, event: Any) -> Span:
    """Where an event is in the text; of one over several lines, where it begins."""
    start, end = event.start_mark, event.end_mark
    first = source.offset(start.line + 1, start.column + 1)
    last = source.offset(end.line + 1, end.column + 1) if end.line == start.line else first
    return Span(source, first, max(last, first))


class _TreeBuilder:
    """Builds values from YAML events, within limits."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.count = 0
        self.anchors: dict[str, tuple[Tree, int]] = {}

    def _span(self, event: Any) -> Span:
        return span_of(self.source, event)

    def build(self, events: Iterator[Any]) -> Tree | None:
        # Each open collection: its value, its span, the key without a value yet, its anchor, the count before it.
        stack: list[tuple[Any, Span, list[tuple[str, Span]], str | None, int]] = []
        root: Tree | None = None
        documents = 0
        for event in events:
            kind = type(event).__name__
            if kind in {"StreamStartEvent", "StreamEndEvent", "DocumentStartEvent", "DocumentEndEvent"}:
                documents += kind == "DocumentStartEvent"
                if documents > 1:
                    raise InvalidYaml(self._span(event), "a parameter file must be a single YAML document")
                continue
            if (tag := getattr(event, "tag", None)) is not None and tag != _TAGS[kind]:
                help = "remove the tag; put text in double quotes"
                raise InvalidYaml(self._span(event), f"ROS parameter files have no tag `{tag}` here", help)
            if kind in {"MappingStartEvent", "SequenceStartEvent"}:
                if len(stack) >= MAX_DEPTH:
                    raise InvalidYaml(self._span(event), f"this is nested more than {MAX_DEPTH} deep")
                if stack and isinstance(stack[-1][0], dict) and not stack[-1][2]:
                    raise InvalidYaml(self._span(event), "a parameter name must be a string")
                value: Any = {} if kind == "MappingStartEvent" else []
                stack.append((value, self._span(event), [], event.anchor, self.count))
                continue
            if kind in {"MappingEndEvent", "SequenceEndEvent"}:
                value, span, _, anchor, before = stack.pop()
                done: Tree = (value, span)
                if anchor:
                    self.anchors[anchor] = (done, self.count - before)
            elif kind == "AliasEvent":
                if event.anchor not in self.anchors:
                    raise InvalidYaml(self._span(event), f"undefined alias `*{event.anchor}`")
                done, size = self.anchors[event.anchor]
                self.count += size
            else:
                done = (_scalar(event, self._span(event)), self._span(event))
                self.count += 1
                if event.anchor:
                    self.anchors[event.anchor] = (done, 1)
            if self.count > MAX_VALUES:
                raise InvalidYaml(done[1], f"this file has more than {MAX_VALUES} values")
            if not stack:
                root = done
            elif isinstance(stack[-1][0], list):
                stack[-1][0].append(done)
            elif not stack[-1][2]:
                key, place = done
                if isinstance(key, (dict, list)) or key is None:
                    raise InvalidYaml(place, "a parameter name must be a string")
                stack[-1][2].append((event.value if kind == "ScalarEvent" else str(key), place))
            else:
                name, place = stack[-1][2].pop()
                if name in stack[-1][0]:
                    raise InvalidYaml(place, f"duplicate key `{name}`", "keep one of them")
                stack[-1][0][name] = done
        return None if root is None or root[0] is None else root


def _scalar(event: Any, span: Span) -> Scalar | None:
    text: str = event.value
    if not event.implicit[0]:
        return text  # quoted, a block of text, or tagged as a string
    if text in {"", "~", "null", "Null", "NULL"}:
        return None
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if (match := _INTEGER.fullmatch(text)) is not None:
        base = 16 if match["hex"] else 8 if match["octal"] else 10
        if len(text) > 40 or not -(2**63) <= (number := int(text, base)) < 2**63:
            raise InvalidYaml(span, "integers have at most 64 bits")
        return number
    if _REAL.fullmatch(text) and "." in text:  # PyYAML has `08` and `1e3` as text
        if math.isinf(value := float(text)):
            raise InvalidYaml(span, "this number is too large")
        return value
    if _NOT_FINITE.fullmatch(text):
        return float(canonical(float(text.replace(".", ""))))
    return text
