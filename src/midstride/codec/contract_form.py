"""The JSON forms of contracts: predicates, QoS profiles, sets of values.

``{"type": "std_msgs/msg/String", "rate": 10, "qos": {"depth": 5}, "where": {"width": {">=": 640}}}``

A rate is in Hz; a key whose value is a duration ends in ``_seconds``. A field is constrained with ``=``, ``in``,
``>=``, ``>``, ``<=``, ``<``, which hold together; ``{}`` is any number.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import Annotated, Any, ClassVar, TypeAlias

import msgspec
from msgspec import UNSET, Meta, UnsetType

from midstride.codec.form import (
    END,
    LARGEST,
    TOKEN,
    FiniteNumber,
    Form,
    PositiveSeconds,
    ScalarForm,
    field,
    finite,
    given,
    stated,
)
from midstride.model.contract import (
    DEFAULT_QOS,
    Durability,
    HistoryPolicy,
    Interval,
    Liveliness,
    OneOf,
    Predicate,
    QoS,
    Reliability,
    ValueSet,
)

Bound: TypeAlias = Annotated[int | FiniteNumber, field("a number")]


class ValuesForm(Form, frozen=True):
    """A set of values: all that is stated holds."""

    what: ClassVar[str] = "a field constraint"

    equal: ScalarForm | UnsetType = msgspec.field(default=UNSET, name="=")
    one_of: Annotated[list[ScalarForm], field("a list of values")] | UnsetType = msgspec.field(default=UNSET, name="in")
    at_least: Bound | UnsetType = msgspec.field(default=UNSET, name=">=")
    above: Bound | UnsetType = msgspec.field(default=UNSET, name=">")
    at_most: Bound | UnsetType = msgspec.field(default=UNSET, name="<=")
    below: Bound | UnsetType = msgspec.field(default=UNSET, name="<")

    @classmethod
    def of(cls, values: ValueSet) -> ValuesForm:
        if isinstance(values, OneOf):
            members = list(values.values)
            return cls(equal=members[0]) if len(members) == 1 else cls(one_of=members)
        low = UNSET if math.isinf(values.low) else values.low
        high = UNSET if math.isinf(values.high) else values.high
        return cls(
            at_least=UNSET if values.low_open else low,
            above=low if values.low_open else UNSET,
            at_most=UNSET if values.high_open else high,
            below=high if values.high_open else UNSET,
        )

    def value_set(self) -> ValueSet:
        """Raises ValueError for a number that no float can hold."""
        sets: list[ValueSet] = []
        if self.equal is not UNSET:
            sets.append(OneOf.of([finite(self.equal)]))
        if self.one_of is not UNSET:
            sets.append(OneOf.of(map(finite, self.one_of)))
        for low, is_open in ((self.at_least, False), (self.above, True)):
            if low is not UNSET:
                sets.append(Interval(low=finite(low), low_open=is_open))
        for high, is_open in ((self.at_most, False), (self.below, True)):
            if high is not UNSET:
                sets.append(Interval(high=finite(high), high_open=is_open))
        return reduce(lambda one, other: one.intersection(other), sets) if sets else Interval()


class QoSForm(Form, frozen=True):
    """A QoS profile; what is not stated is ROS 2's default."""

    what: ClassVar[str] = "a QoS profile"

    reliability: Reliability | UnsetType = UNSET
    durability: Durability | UnsetType = UNSET
    deadline: PositiveSeconds | UnsetType = msgspec.field(default=UNSET, name="deadline_seconds")
    liveliness: Liveliness | UnsetType = UNSET
    lease: PositiveSeconds | UnsetType = msgspec.field(default=UNSET, name="lease_seconds")
    depth: Annotated[int, field("a depth", ge=1)] | UnsetType = UNSET
    history: HistoryPolicy | UnsetType = UNSET
    lifespan: PositiveSeconds | UnsetType = msgspec.field(default=UNSET, name="lifespan_seconds")

    @classmethod
    def of(cls, qos: QoS) -> QoSForm:
        return cls(**{name: stated(getattr(qos, name)) for name in cls.__struct_fields__})

    def qos(self) -> QoS:
        return QoS(**{name: given(finite(getattr(self, name))) for name in self.__struct_fields__})


MessageType: TypeAlias = Annotated[
    str,
    field(
        "a message type",
        "the message type, pkg/msg/Type or pkg/Type",
        help="write it as `std_msgs/msg/String`",
        min_length=1,
        pattern=f"^{TOKEN}/(msg/)?{TOKEN}{END}",
    ),
]
AnyType: TypeAlias = Annotated[
    str,
    field(
        "a type",
        "the type of a message, pkg/msg/Type or pkg/Type, of a service, pkg/srv/Type, or of a ROS action, "
        "pkg/action/Type",
        help="write it as `std_msgs/msg/String` or `std_srvs/srv/Trigger`",
        min_length=1,
        pattern=f"^{TOKEN}/((msg|srv|action)/)?{TOKEN}{END}",
    ),
]
Rate: TypeAlias = Annotated[float, field("a rate in Hz", "in Hz, at least", gt=0, le=LARGEST)]
FieldPath: TypeAlias = Annotated[
    str, field("the path of a field", help="write it as `header.frame_id`", pattern=rf"^[^\W\d]\w*(\.[^\W\d]\w*)*{END}")
]
WhereForm: TypeAlias = Annotated[
    dict[FieldPath, ValuesForm], field("an object of fields", "the values that fields may have, by dotted path")
]


WithinForm: TypeAlias = Annotated[
    PositiveSeconds, Meta(description="within which a request is answered, or a goal accepted or rejected")
]


class PredicateForm(Form, frozen=True):
    """A guarantee or an assumption: what messages are like, or how soon a service or ROS action answers."""

    what: ClassVar[str] = "a predicate"

    type: AnyType
    rate: Rate | UnsetType = UNSET
    qos: QoSForm | UnsetType = UNSET
    where: WhereForm | UnsetType = UNSET
    within: WithinForm | UnsetType = msgspec.field(default=UNSET, name="within_seconds")

    @classmethod
    def of(cls, predicate: Predicate) -> PredicateForm:
        return cls(**predicate_keys(predicate))

    def predicate(self) -> Predicate:
        return Predicate(
            type=self.type,
            rate=given(self.rate),
            qos=DEFAULT_QOS if self.qos is UNSET else self.qos.qos(),
            fields=() if self.where is UNSET else tuple((path, form.value_set()) for path, form in self.where.items()),
            within=given(finite(self.within)),
        )


def predicate_keys(predicate: Predicate) -> dict[str, Any]:
    """The fields of a form that states the predicate."""
    return {
        "type": predicate.type,
        "rate": stated(predicate.rate),
        "qos": UNSET if predicate.qos == DEFAULT_QOS else QoSForm.of(predicate.qos),
        "where": {path: ValuesForm.of(values) for path, values in predicate.fields} or UNSET,
        "within": stated(predicate.within),
    }
