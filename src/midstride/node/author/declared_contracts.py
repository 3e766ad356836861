"""From what an author writes to the model's contracts: types, rates, QoS and field constraints."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias, TypeGuard, get_args

from midstride.errors import NodeError
from midstride.model.contract import DEFAULT_QOS, Interval, OneOf, Predicate, QoS, ValueSet

# What may be written for a set of values: the set itself, its members, or its only member.
FieldConditions: TypeAlias = Mapping[str, Any]

# The class of what a client sends, as its type names it, by the folder of the type.
REQUEST_OF: Final = {"srv": "Request", "action": "Goal"}

_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_POLICIES: Final = {
    "reliability": ("reliable", "best_effort"),
    "durability": ("transient_local", "volatile"),
    "liveliness": ("automatic", "manual_by_topic"),
    "history": ("keep_last", "keep_all"),
}


def at_least(value: float) -> Interval:
    """The numbers greater than or equal to ``value``: ``where={"width": at_least(640)}``."""
    return Interval(low=float(value))


def at_most(value: float) -> Interval:
    """The numbers less than or equal to ``value``."""
    return Interval(high=float(value))


def between(low: float, high: float) -> Interval:
    """The numbers from ``low`` to ``high``, including both."""
    return Interval(float(low), float(high))


@dataclass(frozen=True, slots=True)
class Guarantee:
    """The guarantee of a mode for an output. Created by :func:`guarantee`."""

    rate: float | None
    where: tuple[tuple[str, ValueSet], ...]


NO_PROMISE: Final = Guarantee(None, ())


def guarantee(rate: float | None = None, where: FieldConditions | None = None) -> Guarantee:
    """State the guarantee of a mode for an output: ``guarantees={out: guarantee(rate=20, where={"width": 640})}``.

    ``rate`` is in Hz; ``where`` is written as for ``Component.create_input`` (docs/semantics.md section 1). Raises
    NodeError.
    """
    return Guarantee(check_rate(rate, "guarantee()"), field_constraints(where, None, "guarantee()"))


def check_name(name: object, what: str) -> str:
    if not isinstance(name, str) or not _NAME.match(name):
        raise NodeError(f"{what}: {name!r} is not a name; write letters, digits and _, not starting with a digit")
    return name


def _is_positive(value: object) -> TypeGuard[int | float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and value > 0


def check_rate(rate: object, where: str) -> float | None:
    if rate is not None and not _is_positive(rate):
        raise NodeError(f"{where}: rate={rate!r} is not a rate; write a positive number of Hz, or leave it out")
    return None if rate is None else float(rate)


def check_seconds(seconds: object, where: str) -> float:
    if not _is_positive(seconds):
        raise NodeError(f"{where}: {seconds!r} is not a duration; write a number of seconds greater than 0")
    return float(seconds)


def check_missed(missed: object, assumption: Predicate, where: str) -> int | None:
    if missed is None:
        return None
    if not isinstance(missed, int) or isinstance(missed, bool) or missed < 1:
        raise NodeError(f"{where}: tolerates={missed!r}; write a whole number of missed messages, at least 1")
    if assumption.rate is None and assumption.qos.deadline is None:
        raise NodeError(f"{where}: tolerates={missed} needs a rate, else no message is ever missed; write rate=")
    return missed


def check_weight(weight: object, where: str) -> float:
    if not _is_positive(weight):
        raise NodeError(f"{where}: weight={weight!r}; write a number greater than 0")
    return float(weight)


def check_qos(qos: object, where: str) -> QoS:
    if qos is None:
        return DEFAULT_QOS
    if isinstance(qos, int) and not isinstance(qos, bool) and qos > 0:
        return QoS(depth=qos)  # as rclpy understands it
    if not isinstance(qos, QoS):
        raise NodeError(f"{where}: qos={qos!r} is not a QoS profile; write e.g. QoS(reliability='best_effort')")
    for policy, allowed in _POLICIES.items():
        value = getattr(qos, policy)
        if value is not None and value not in allowed:
            raise NodeError(
                f"{where}: {policy}={value!r} is not a value of that policy; write {' or '.join(map(repr, allowed))}"
            )
    for policy in ("deadline", "lease", "lifespan", "depth"):
        value = getattr(qos, policy)
        if value is not None and not value > 0:
            raise NodeError(f"{where}: {policy}={value!r} must be greater than 0; leave it out for ROS's default")
    return qos


def check_type(type_: object, where: str) -> type:
    if not isinstance(type_, type):
        raise NodeError(f"{where}: {type_!r} is not a message class; write e.g. `from std_msgs.msg import String`")
    type_name(type_, where)
    return type_


def type_name(type_: type, where: str = "message type", kind: str = "msg") -> str:
    """``std_msgs/msg/String`` for its class, whichever ROS the class is from. Raises NodeError for any other class.

    ``kind``: the folder of the type, ``srv`` for a service.
    """
    for attribute in ("__msgtype__", "_type"):  # the simulator's own, ROS 1's
        name = getattr(type_, attribute, None)
        if isinstance(name, str):
            package, _, rest = name.partition("/")
            return f"{package}/{kind}/{rest.rpartition('/')[2]}"
    parts = type_.__module__.split(".")  # ROS 2: std_msgs.msg._string
    if len(parts) >= 2 and parts[1] == kind:
        return f"{parts[0]}/{kind}/{type_.__name__}"
    raise NodeError(f"{where}: {type_.__name__} is not {class_of(kind)}")


_CLASSES: Final = {
    "msg": ("a ROS message class", "std_msgs.msg import String"),
    "srv": ("the class of a service", "std_srvs.srv import Trigger"),
    "action": ("the class of a ROS action", "nav2_msgs.action import NavigateToPose"),
}


def class_of(kind: str) -> str:
    """Return what the class of a type of that folder is, and an example."""
    what, example = _CLASSES[kind]
    return f"{what}; write e.g. `from {example}`"


def field_constraints(
    where: FieldConditions | None, type_: type | None, context: str
) -> tuple[tuple[str, ValueSet], ...]:
    """The constraints an author states, one set of values for each field's path."""
    if where is None:
        return ()
    if not isinstance(where, Mapping):
        raise NodeError(f"{context}: where={where!r} must map fields to values; write where={{'width': at_least(640)}}")
    found = []
    for path, values in where.items():
        if type_ is not None:
            _check_field(path, type_, context)
        found.append((path, _value_set(values, f"{context}, where {path}")))
    return tuple(found)


def _value_set(values: Any, context: str) -> ValueSet:
    if isinstance(values, get_args(ValueSet)):
        found: ValueSet = values
    elif isinstance(values, (bool, int, float, str)):
        found = OneOf.of([values])
    elif isinstance(values, (set, frozenset, list)):
        for value in values:
            if not isinstance(value, (bool, int, float, str)):
                raise NodeError(
                    f"{context}: {value!r} cannot be the value of a field; write numbers, strings or booleans"
                )
        found = OneOf.of(values)
    else:
        raise NodeError(
            f"{context}: {values!r} is not a set of values; write a value, a set of values, at_least(…), at_most(…) "
            "or between(…, …)"
        )
    if found.is_empty:
        raise NodeError(f"{context}: {values!r} contains no value, so no message could satisfy it")
    return found


def _check_field(path: str, type_: type, context: str) -> None:
    """Raises NodeError where messages of ``type_`` lack the field: a constraint on it could never be met."""
    try:
        value = type_()
    except TypeError:
        return  # the fields of a class without a default constructor are not known
    reached: list[str] = []
    for part in str(path).split("."):
        if not hasattr(value, part):
            owner = ".".join(reached) or type_name(type_)
            raise NodeError(f"{context}: {owner} has no field {part!r}{_fields_hint(value)}")
        value = getattr(value, part)
        reached.append(part)


def _fields_hint(message: Any) -> str:
    fields = getattr(type(message), "get_fields_and_field_types", None)
    names = list(fields()) if fields else list(getattr(message, "__dataclass_fields__", ()))
    names = [name for name in names if not name.startswith("_")]
    return f"; its fields are {', '.join(names)}" if names else ""


def check_service(type_: object, where: str, kind: str = "srv") -> type:
    """Return the class of a service or ROS action (``kind``) of ROS 2. Raises NodeError for any other class."""
    if hasattr(type_, "_request_class"):  # of ROS 1
        raise NodeError(f"{where}: only ROS 2 has services as ports; on ROS 1, create it in on_setup")
    if not isinstance(type_, type) or not hasattr(type_, REQUEST_OF[kind]):
        raise NodeError(f"{where}: {type_!r} is not {class_of(kind)}")
    type_name(type_, where, kind)
    return type_


def check_within(within: object, where: str) -> float | None:
    """Return a bound (s), or None where none is stated. Raises NodeError."""
    return None if within is None else check_seconds(within, f"{where}, within=")
