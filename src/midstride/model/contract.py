"""Contracts: what travels through a port, and when one contract satisfies another.

A :class:`Predicate` states a type and, optionally, for messages a rate, a QoS profile and constraints on fields, for a
service or a ROS action how soon a request is answered. As a *guarantee* it says what is provided, as an *assumption*
what is needed. :data:`NOTHING` is the contract of an output that provides nothing. ``satisfies`` says whether a
guarantee is good enough for an assumption, ``explain`` says clause by clause why it is not (docs/semantics.md
section 1; the paper's section 5.1, with QoS and fields added).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Literal, TypeAlias

Scalar: TypeAlias = bool | int | float | str
Reliability: TypeAlias = Literal["reliable", "best_effort"]
Durability: TypeAlias = Literal["transient_local", "volatile"]
Liveliness: TypeAlias = Literal["automatic", "manual_by_topic"]
HistoryPolicy: TypeAlias = Literal["keep_last", "keep_all"]


# What a connector is: a topic, or a service or ROS action, where a server is an output and a client an input.
ConnectorKind: TypeAlias = Literal["topic", "service", "action"]
_KIND_OF_FOLDER: Final[dict[str, ConnectorKind]] = {"srv": "service", "action": "action"}


def connector_kind(type_name: str) -> ConnectorKind:
    """The kind of connector with that type: that of ``pkg/srv/Type`` is a service, of ``pkg/action/Type`` an action."""
    return _KIND_OF_FOLDER.get(type_name.partition("/")[2].partition("/")[0], "topic")


# What a bound is on, in the words of the language.
BOUND_WORDS: Final[dict[ConnectorKind, str]] = {"topic": "responds", "service": "responds", "action": "accepts"}


def canonical_type(name: str) -> str:
    """``pkg/Type`` and ``pkg/msg/Type`` name the same type; the longer form is the canonical one."""
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name


def format_number(number: float) -> str:
    """A number in the fewest digits that tell it from every other one: ``10``, ``0.1``, ``33.3333333``."""
    value = float(number)
    short = f"{value:g}"
    if float(short) == value or math.isnan(value):
        return short
    return str(int(value)) if value.is_integer() and abs(value) < 2**53 else repr(value)


@dataclass(frozen=True, slots=True)
class QoS:
    """A QoS profile. None means that the policy is not stated: ROS 2's default applies, on either side.

    ``deadline``, ``lease`` and ``lifespan`` are in seconds. ``depth``, ``history`` and ``lifespan`` configure the
    endpoint, and are not compared between publishers and subscribers (docs/semantics.md section 1).
    """

    reliability: Reliability | None = None
    durability: Durability | None = None
    deadline: float | None = None
    liveliness: Liveliness | None = None
    lease: float | None = None
    depth: int | None = None
    history: HistoryPolicy | None = None
    lifespan: float | None = None

    def unmet_by(self, offered: QoS) -> list[str]:
        """The policies, requested by this profile, for which ``offered`` is too weak (DDS request/offer)."""
        unmet: list[str] = []
        if self.is_reliable and not offered.is_reliable:
            unmet.append("reliability: best_effort is offered, reliable is needed")
        if self.is_transient_local and not offered.is_transient_local:
            unmet.append("durability: volatile is offered, transient_local is needed")
        for name in ("deadline", "lease"):
            needed = getattr(self, name)
            if needed is not None and (given := _seconds(getattr(offered, name))) > needed:
                unmet.append(f"{name}: {_duration(given)} is offered, at most {_duration(needed)} is needed")
        if self.liveliness == "manual_by_topic" and offered.liveliness != "manual_by_topic":
            unmet.append("liveliness: automatic is offered, manual_by_topic is needed")
        return unmet

    @property
    def is_reliable(self) -> bool:
        return self.reliability != "best_effort"

    @property
    def is_transient_local(self) -> bool:
        return self.durability == "transient_local"

    def same_endpoint(self, other: QoS) -> bool:
        """Return whether both describe the same real endpoint (rule M3), with or without the defaults written out."""
        return self.effective() == other.effective()

    def effective(self) -> QoS:
        """This profile with ROS 2's defaults filled in for the policies that matter to an endpoint."""
        return replace(
            self,
            reliability=self.reliability or "reliable",
            durability=self.durability or "volatile",
            liveliness=self.liveliness or "automatic",
            depth=10 if self.depth is None else self.depth,
            history=self.history or "keep_last",
        )

    def __str__(self) -> str:
        stated = [
            f"{name} = {_duration(value) if isinstance(value, float) else value}"
            for name in self.__slots__
            if (value := getattr(self, name)) is not None
        ]
        return f"qos({', '.join(stated)})" if stated else ""


def _seconds(stated: float | None) -> float:
    return math.inf if stated is None else stated


def _duration(seconds: float) -> str:
    return "none" if math.isinf(seconds) else f"{format_number(seconds)} s"


DEFAULT_QOS: Final = QoS()


@dataclass(frozen=True, slots=True)
class Interval:
    """A set of reals between two ends, either of which may be open or infinite."""

    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False

    def __post_init__(self) -> None:
        if math.isinf(self.low):  # an infinite end is never reached, so open and closed mean the same
            object.__setattr__(self, "low_open", False)
        if math.isinf(self.high):
            object.__setattr__(self, "high_open", False)

    def __contains__(self, value: object) -> bool:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        above = value > self.low if self.low_open else value >= self.low
        below = value < self.high if self.high_open else value <= self.high
        return above and below

    @property
    def is_empty(self) -> bool:
        return self.low > self.high or (self.low == self.high and (self.low_open or self.high_open))

    def is_subset(self, other: ValueSet) -> bool:
        if self.is_empty:
            return True
        if isinstance(other, OneOf):
            return self.low == self.high and self.low in other
        starts_inside = self.low > other.low or (self.low == other.low and (self.low_open or not other.low_open))
        ends_inside = self.high < other.high or (self.high == other.high and (self.high_open or not other.high_open))
        return starts_inside and ends_inside

    def intersection(self, other: ValueSet) -> ValueSet:
        if isinstance(other, OneOf):
            return other.intersection(self)
        low, low_open = max((self.low, self.low_open), (other.low, other.low_open))
        high, high_closed = min((self.high, not self.high_open), (other.high, not other.high_open))
        return Interval(low, high, low_open, not high_closed)

    def __str__(self) -> str:
        if self.low == self.high and not self.is_empty:
            return f"= {format_number(self.low)}"
        if math.isinf(self.low) and not math.isinf(self.high):
            return f"{'<' if self.high_open else '<='} {format_number(self.high)}"
        if math.isinf(self.high) and not math.isinf(self.low):
            return f"{'>' if self.low_open else '>='} {format_number(self.low)}"
        ends = f"{format_number(self.low)}, {format_number(self.high)}"
        return f"in {'(' if self.low_open else '['}{ends}{')' if self.high_open else ']'}"


@dataclass(frozen=True, slots=True)
class OneOf:
    """A finite set of values. Numbers compare as reals; a boolean is never a number."""

    members: frozenset[tuple[str, Scalar]]

    @classmethod
    def of(cls, values: Iterable[Scalar]) -> OneOf:
        return cls(frozenset(_tagged(value) for value in values))

    @property
    def values(self) -> tuple[Scalar, ...]:
        """The members, in a stable order."""
        return tuple(value for _, value in sorted(self.members))

    def __contains__(self, value: object) -> bool:
        return isinstance(value, (bool, int, float, str)) and _tagged(value) in self.members

    @property
    def is_empty(self) -> bool:
        return not self.members

    def is_subset(self, other: ValueSet) -> bool:
        return all(value in other for _, value in self.members)

    def intersection(self, other: ValueSet) -> ValueSet:
        return OneOf(frozenset(member for member in self.members if member[1] in other))

    def __str__(self) -> str:
        values = [_literal(value) for value in self.values]
        return f"= {values[0]}" if len(values) == 1 else f"in {{{', '.join(values)}}}"


def _tagged(value: Scalar) -> tuple[str, Scalar]:
    if isinstance(value, bool):
        return ("boolean", value)
    return ("text", value) if isinstance(value, str) else ("number", value)


def _literal(value: Scalar) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value if value.isidentifier() else '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)


ValueSet: TypeAlias = Interval | OneOf


class _Nothing(Enum):
    """The predicate of an output that produces nothing: it satisfies no predicate at all."""

    NOTHING = "nothing"

    def __str__(self) -> str:
        return "nothing"


NOTHING: Final = _Nothing.NOTHING
Nothing: TypeAlias = Literal[_Nothing.NOTHING]


@dataclass(frozen=True, slots=True)
class Predicate:
    """The messages or requests of a port: its type, and for messages their rate (Hz), QoS, and the values of fields.

    As a guarantee it says what is provided (at least ``rate``), as an assumption what is needed. ``within``: the bound
    (s) within which a service answers a request, or an action accepts or rejects a goal.
    ``fields`` holds one set of values for each constrained field, sorted by the field's path; several constraints on
    one field are intersected.
    """

    type: str
    rate: float | None = None
    qos: QoS = DEFAULT_QOS
    fields: tuple[tuple[str, ValueSet], ...] = ()
    within: float | None = None

    def __post_init__(self) -> None:
        """Normalise: one set of values for each field, and a one-point interval becomes a value."""
        object.__setattr__(self, "type", canonical_type(self.type))
        if self.fields:
            sets: dict[str, ValueSet] = {}
            for path, values in self.fields:
                sets[path] = sets[path].intersection(values) if path in sets else values
            for path, values in sets.items():
                if isinstance(values, Interval) and values.low == values.high and not values.is_empty:
                    sets[path] = OneOf.of([values.low])
            object.__setattr__(self, "fields", tuple(sorted(sets.items(), key=lambda entry: entry[0])))

    @property
    def kind(self) -> ConnectorKind:
        return connector_kind(self.type)

    @property
    def is_empty(self) -> bool:
        """Return whether no message can be like this, because the constraints on a field contradict each other."""
        return any(values.is_empty for _, values in self.fields)

    def constraint(self, path: str) -> ValueSet | None:
        """The set of values the field at ``path`` is constrained to, or None."""
        return next((values for name, values in self.fields if name == path), None)

    def __str__(self) -> str:
        text = self.type
        if self.rate is not None:
            text += f" @ {format_number(self.rate)} Hz"
        if self.within is not None:
            text += f" {BOUND_WORDS[self.kind]} within {_duration(self.within)}"
        if qos := str(self.qos):
            text += f" {qos}"
        if self.fields:
            text += " where " + ", ".join(f"{path} {values}" for path, values in self.fields)
        return text


Contract: TypeAlias = Predicate | Nothing


def satisfies(offered: Contract, needed: Contract) -> bool:
    """``offered ⊨ needed`` (docs/semantics.md section 1): transitive, and reflexive except for ``nothing``."""
    if offered is needed:
        return offered is not NOTHING
    if isinstance(offered, _Nothing) or isinstance(needed, _Nothing):
        return False
    if offered.type != needed.type:
        return False
    if needed.rate is not None and (offered.rate is None or offered.rate < needed.rate):
        return False
    if needed.within is not None and (offered.within is None or offered.within > needed.within):
        return False
    if offered.qos is not needed.qos and offered.qos != needed.qos and needed.qos.unmet_by(offered.qos):
        return False
    for path, values in needed.fields:
        given = offered.constraint(path)
        if given is None or not given.is_subset(values):
            return False
    return True


def explain(offered: Contract, needed: Contract) -> list[str]:
    """The clauses in which ``offered`` falls short of ``needed``; empty iff ``satisfies`` holds."""
    if isinstance(offered, _Nothing) or isinstance(needed, _Nothing):
        return ["nothing is guaranteed" if offered is NOTHING else "nothing can satisfy `nothing`"]
    clauses: list[str] = []
    if offered.type != needed.type:
        clauses.append(f"type: {offered.type} is offered, {needed.type} is needed")
    if needed.rate is not None and (offered.rate is None or offered.rate < needed.rate):
        given = "no rate" if offered.rate is None else f"{format_number(offered.rate)} Hz"
        clauses.append(f"rate: {given} is offered, at least {format_number(needed.rate)} Hz is needed")
    if needed.within is not None and (offered.within is None or offered.within > needed.within):
        given = (
            "no bound" if offered.within is None else f"{BOUND_WORDS[offered.kind]} within {_duration(offered.within)}"
        )
        clauses.append(f"bound: {given} is offered, at most {_duration(needed.within)} is needed")
    clauses.extend(needed.qos.unmet_by(offered.qos))
    for path, values in needed.fields:
        given_values = offered.constraint(path)
        if given_values is None:
            clauses.append(f"field {path}: not constrained, {path} {values} is needed")
        elif not given_values.is_subset(values):
            clauses.append(f"field {path}: {path} {given_values} is offered, {path} {values} is needed")
    return clauses
