"""The parameters that rcl has after it has read parameter files, with the place of each value.

A parameter file is not any YAML: rcl's parser (rcl_yaml_param_parser) goes through the events of a file with a few
variables, and what it makes of keys that occur twice, maps in lists or a name that is both a value and a prefix follows
from these. So the same is done here, step by step; tests compare the two.
"""

from __future__ import annotations

import math
import re
from bisect import insort
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Final, Literal, NamedTuple

from midstride.lang.source import Source, Span
from midstride.lang.yaml_events import InvalidYaml, events, span_of
from midstride.model.component import ParameterValue
from midstride.model.contract import Scalar

KEY: Final = "ros__parameters"
# Bounds on what a hostile file costs; the largest of the public ones have some thousand values, eight deep.
MAX_DEPTH: Final = 100
MAX_VALUES: Final = 50_000

_TRUE: Final = frozenset("Y y yes Yes YES true True TRUE on On ON".split())
_FALSE: Final = frozenset("N n no No NO false False FALSE off Off OFF".split())
_STRING_TAG: Final = "tag:yaml.org,2002:str"
_SPACES: Final = r"[ \t\n\v\f\r]*"  # which strtoll and strtod skip
_INTEGER: Final = re.compile(
    rf"{_SPACES}(?P<sign>[-+]?)(0[xX](?P<hex>[0-9a-fA-F]+)|(?P<octal>0[0-7]*)|(?P<decimal>[1-9][0-9]*))"
)
_REAL: Final = re.compile(rf"{_SPACES}(?P<decimal>[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?)")
_HEXADECIMAL: Final = re.compile(
    rf"{_SPACES}(?P<number>[-+]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP](?P<exponent>[-+]?[0-9]+))?)"
)
_WORDS: Final = re.compile(rf"{_SPACES}(?P<sign>[-+]?)((?P<infinity>inf|infinity)|nan(\([A-Za-z0-9_]*\))?)", re.I)
_POINTED: Final = re.compile(r"(?P<sign>[-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_SMALLEST: Final = 2.0**-1022  # of the numbers with all their digits
_LARGEST_EXPONENT: Final = 4000  # beyond any that a float or the digits before it can make up for

_NODE_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,254}", re.ASCII)
_LONGEST_NAMESPACE: Final = 245

# The kinds of values, in the order in which a node takes the first that is there.
_Kind = Literal["bool", "int", "float", "str", "bool list", "int list", "float list", "str list"]
_KINDS: Final[tuple[_Kind, ...]] = (
    "bool", "int", "float", "str", "bool list", "int list", "float list", "str list",
)  # fmt: skip
_LIST_OF: Final[dict[str, _Kind]] = {
    "bool": "bool list", "int": "int list", "float": "float list", "str": "str list",
}  # fmt: skip


class ParameterValueAt(NamedTuple):
    """The value of a parameter, and where it is set."""

    value: ParameterValue
    span: Span


@dataclass(slots=True)
class _Entry:
    """A parameter: its value of each kind that it was given; without one, it has no value, as an empty list."""

    name: str
    span: Span
    values: dict[_Kind, Any] = field(default_factory=dict)

    def value(self) -> ParameterValueAt:
        found: ParameterValue = next((self.values[kind] for kind in _KINDS if kind in self.values), [])
        return ParameterValueAt(found, self.span)


class _Node:
    """The parameters of one section. A name may occur twice; then the last entry counts."""

    def __init__(self, name: str, span: Span) -> None:
        self.name = name
        self.span = span
        self.entries: list[_Entry] = []
        self._indices: dict[str, list[int]] = {}

    def find(self, name: str, span: Span) -> int:
        """The index of the first parameter of that name, which is added if there is none."""
        if not (found := self._indices.setdefault(name, [])):
            found.append(len(self.entries))
            self.entries.append(_Entry(name, span))
        return found[0]

    def rename(self, index: int, name: str) -> None:
        entry = self.entries[index]
        self._indices[entry.name].remove(index)
        insort(self._indices.setdefault(name, []), index)
        entry.name = name

    def values(self) -> dict[str, ParameterValueAt]:
        return {entry.name: entry.value() for entry in self.entries}


class RclParameters:
    """All sections of the files read so far, each at the place where its name has come first."""

    def __init__(self) -> None:
        self._nodes: dict[str, _Node] = {}

    def read(self, source: Source) -> None:
        """Read another file, as rcl reads several `--params-file`. Raises InvalidYaml; then this is of no more use."""
        _FileReader(self._nodes, source).read()

    def sections(self) -> Iterator[tuple[str, Span, dict[str, ParameterValueAt]]]:
        """Of each section: the name of its nodes, where it is named first, and its values."""
        return ((node.name, node.span, node.values()) for node in self._nodes.values())


class _Prefix:
    """The names in front of the next one, joined by ``separator``. A name may contain the separator itself."""

    def __init__(self, separator: str) -> None:
        self.separator = separator
        self.text = ""
        self.count = 0

    def add(self, name: str) -> None:
        joined = self.count and not self.text.endswith(self.separator)
        self.text = f"{self.text}{self.separator if joined else ''}{name}" if self.count else name
        self.count += 1

    def drop(self) -> None:
        """Take away what follows the last separator."""
        if self.count:
            before, found, _ = self.text.rpartition(self.separator)
            self.text = "" if self.count == 1 else before if found else self.text
            self.count -= 1

    def set(self, text: str) -> None:
        self.text = text
        self.count += 1


class _FileReader:
    """Carries out the events of one file. The variables are those of rcl's ``parse_file_events``."""

    def __init__(self, nodes: dict[str, _Node], source: Source) -> None:
        self.nodes = nodes
        self.source = source
        self.in_parameters = False
        self.is_key = True
        self.is_sequence = False
        self.is_new_map = False
        self.depth = 0
        self.sequence_kind: str | None = None
        self.node_names = _Prefix("/")
        self.parameter_names = _Prefix(".")
        self.node: _Node | None = None
        self.index = 0
        self.count = 0

    def read(self) -> None:
        """Raises InvalidYaml."""
        for event in events(self.source):
            kind = type(event).__name__
            span = span_of(self.source, event)
            match kind:
                case "ScalarEvent":
                    self.count += 1
                    if self.count > MAX_VALUES:
                        raise InvalidYaml(span, f"this file has more than {MAX_VALUES} keys and values")
                    self._scalar(event, span)
                case "SequenceStartEvent":
                    self._sequence(span)
                case "SequenceEndEvent":
                    self.is_sequence, self.is_key = False, True
                case "MappingStartEvent":
                    self._mapping(span)
                case "MappingEndEvent":
                    self._mapping_end()
                case "AliasEvent":
                    message = f"ROS parameter files have no aliases: `*{event.anchor}`"
                    raise InvalidYaml(span, message, "write the value out")
                case _:
                    pass

    # -- events ----------------------------------------------------------------------------------------

    def _scalar(self, event: Any, span: Span) -> None:
        text: str = event.value
        if self.is_key:
            if not text:
                raise InvalidYaml(span, f"a name is empty{self._within()}")
            self._name(text.partition("\0")[0], span)
            self.is_key = False
            return
        if not self.in_parameters or self.node is None:
            raise self._not_in_parameters(text, span)
        if not self.node.entries:
            name = self.node.name
            raise InvalidYaml(span, f"section `{name}` has no parameters", f"write `{name}: {KEY}: name: value`")
        self._value(event, span)
        if not self.is_sequence:
            self.is_key = True

    def _not_in_parameters(self, text: str, span: Span) -> InvalidYaml:
        section, _, name = self.node_names.text.rpartition("/")
        if not name:
            return InvalidYaml(
                span,
                "expected a section of a ROS parameter file",
                f"a parameter file has a section `node:` per node, each with `{KEY}:`",
            )
        if not text or not section:
            help = f"write the parameters under `{self.node_names.text}: {KEY}:`"
            return InvalidYaml(span, f"section `{self.node_names.text}` has no `{KEY}`", help)
        help = f"write `{section}: {KEY}: {name}: …`"
        return InvalidYaml(span, f"`{name}` of section `{section}` is not under `{KEY}`", help)

    def _sequence(self, span: Span) -> None:
        if self.is_key:
            within = self._within()
            if within:
                raise InvalidYaml(span, f"expected a name or the end of the list, not another list{within}")
            raise self._not_in_parameters("", span)
        if not self.in_parameters:
            raise self._not_in_parameters("…", span)
        self.is_sequence, self.sequence_kind = True, None

    def _mapping(self, span: Span) -> None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise InvalidYaml(span, f"this is nested more than {MAX_DEPTH} deep")
        self.is_new_map = self.is_key = True
        if self.in_parameters and self.depth - (self.node_names.count + 1) == 2:
            self.is_new_map = False  # the map of the parameters itself

    def _mapping_end(self) -> None:
        if self.in_parameters:
            if self.parameter_names.count:
                self.parameter_names.drop()
            else:
                self.in_parameters = False
        elif self.depth == self.node_names.count + 1:
            self.node_names.drop()
        self.depth -= 1

    # -- names -----------------------------------------------------------------------------------------

    def _name(self, text: str, span: Span) -> None:
        if self.in_parameters:
            self._parameter(text, span)
        elif not text.startswith(KEY):
            self.node_names.add(text)
        else:
            if not self.node_names.count:
                help = f"write it in a section: `node: {KEY}:`"
                raise InvalidYaml(span, f"`{KEY}` is in no section", help)
            name = self.node_names.text
            if (wrong := _fault_of_name(name)) is not None:
                help = "name a node with its namespace, such as `/robot1/camera`, or use `*` and `**` for whole parts"
                raise InvalidYaml(span, f"`{name}` is no name of a section: {wrong}", help)
            self.node = self.nodes.setdefault(name, _Node(name, span))
            self.node_names.drop()
            self.in_parameters = True

    def _parameter(self, name: str, span: Span) -> None:
        node = self.node
        assert node is not None
        if self.is_new_map:  # the last name is a prefix
            if self.index >= len(node.entries):
                raise InvalidYaml(span, f"`{name}` of section `{node.name}` has no place among its parameters")
            self.parameter_names.set(node.entries[self.index].name)
            self.is_new_map = False
        if not self.parameter_names.count:
            self.index = node.find(name, span)
            return
        prefix = self.parameter_names.text
        self.index = node.find(prefix, span)
        node.rename(self.index, f"{prefix}.{name}")

    # -- values ----------------------------------------------------------------------------------------

    def _value(self, event: Any, span: Span) -> None:
        assert self.node is not None
        if self.index >= len(self.node.entries):
            raise InvalidYaml(span, f"a value without a name{self._within()}")
        entry = self.node.entries[self.index]
        if not event.value and event.style not in {"'", '"'}:
            raise InvalidYaml(span, f"parameter `{entry.name}` of section `{self.node.name}` has no value")
        value = _scalar(event)
        kind = type(value).__name__
        entry.span = span
        if not self.is_sequence:
            entry.values[kind] = value  # type: ignore[index]  # one of the kinds
        elif self.sequence_kind is None:
            self.sequence_kind = kind
            entry.values[_LIST_OF[kind]] = [value]
        elif self.sequence_kind != kind:
            message = f"parameter `{entry.name}` of section `{self.node.name}`: a list cannot mix types"
            raise InvalidYaml(span, message, "write `1.0` for a real number among others, and text in quotes")
        else:
            entry.values[_LIST_OF[kind]].append(value)

    def _within(self) -> str:
        if self.node is None or not self.in_parameters:
            return ""
        if self.index >= len(self.node.entries):
            return f", in section `{self.node.name}`"
        return f", at parameter `{self.node.entries[self.index].name}` of section `{self.node.name}`"


def _scalar(event: Any) -> Scalar:
    text: str = event.value.partition("\0")[0]
    if event.tag == _STRING_TAG or event.style in {"'", '"'}:
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if (integer := _INTEGER.fullmatch(text)) is not None:
        digits, base = (
            (integer["hex"], 16) if integer["hex"] else (integer["octal"], 8) if integer["octal"] else (text, 10)
        )
        if len(text) < 100:
            number = int(digits, base) * (-1 if integer["sign"] == "-" and base != 10 else 1)
            if -(2**63) <= number < 2**63:
                return number
    real = _real(text)
    return text if real is None else real


def _real(text: str) -> float | None:
    """The number that strtod makes of the whole of ``text``; None for a text, and for one that no float comes near."""
    if (pointed := _POINTED.fullmatch(text)) is not None:
        return math.nan if pointed["sign"] is None else math.copysign(math.inf, -1 if pointed["sign"] == "-" else 1)
    if (word := _WORDS.fullmatch(text)) is not None:
        return math.copysign(math.inf, -1 if word["sign"] == "-" else 1) if word["infinity"] else math.nan
    if (real := _REAL.fullmatch(text)) is not None:
        number = float(real["decimal"])
        if math.isinf(number) or (abs(number) < _SMALLEST and not _is_exactly(real["decimal"], number)):
            return None
        return number
    if (hexadecimal := _HEXADECIMAL.fullmatch(text)) is None:
        return None
    if len(hexadecimal["exponent"] or "") > 9 or abs(int(hexadecimal["exponent"] or 0)) > _LARGEST_EXPONENT:
        return None
    try:
        number = float.fromhex(hexadecimal["number"])
    except OverflowError:
        return None
    exact = _hexadecimal_fraction(hexadecimal["number"]) == Fraction(number)
    return number if abs(number) >= _SMALLEST or exact else None


def _is_exactly(decimal: str, number: float) -> bool:
    mantissa, _, exponent = decimal.lower().partition("e")
    if not mantissa.strip("+-0."):
        return True
    return abs(int(exponent or 0)) <= _LARGEST_EXPONENT and Fraction(decimal) == Fraction(number)


def _hexadecimal_fraction(text: str) -> Fraction:
    mantissa, _, exponent = text.lower().replace("0x", "", 1).partition("p")
    whole, _, part = mantissa.partition(".")
    return Fraction(int(whole + part or "0", 16)) * Fraction(2) ** (int(exponent or 0) - 4 * len(part))


def _fault_of_name(name: str) -> str | None:
    """The reason why rcl takes no section of this name, or None."""
    if name in {"/**", "/*"}:
        return None
    namespace, slash, node = name.rpartition("/")
    parts = (namespace if namespace.startswith("/") else f"/{namespace}")[1:].split("/") if slash and namespace else []
    for part in parts:
        if not part:
            return "a part is empty"
        if part not in {"*", "**"} and (not _NODE_NAME.fullmatch(part) or len(part) >= _LONGEST_NAMESPACE):
            return f"`{part}` is no part of a namespace"
    if node not in {"*", "**"} and not _NODE_NAME.fullmatch(node):
        return f"`{node}` is no name of a node"
    return None
