"""The decoders of the JSON form (see :mod:`midstride.model.document`). They note faults and never raise.

What is faulty is replaced by a stand-in that keeps its names, so that one fault makes no others: an
unknown type is ``""``, modes that cannot be read are modes without assumptions or guarantees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any, Final, get_args

from immutables import Map

from midstride.model.component import (
    Assumption,
    ComponentSpec,
    Connector,
    Endpoint,
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterSpec,
    ParameterValue,
    Resource,
)
from midstride.model.contract import (
    DEFAULT_QOS,
    Durability,
    History,
    Interval,
    Liveliness,
    OneOf,
    Predicate,
    QoS,
    Reliability,
    Scalar,
    ValueSet,
)
from midstride.model.diagnostics import suggestion
from midstride.model.name_checks import is_message_type
from midstride.model.reading import Reader, told
from midstride.model.specification import DEFAULT_SECONDS, Constraint, Keep, Limit, Node, Order, Specification

_PREDICATE: Final = ("rate", "qos", "where")
_ENDPOINTS: Final = ("topic", "service", "action")
_QOS_WORDS: Final = {"reliability": Reliability, "durability": Durability, "liveliness": Liveliness, "history": History}
_QOS_SECONDS: Final = ("deadline", "lease", "lifespan")


def decode_specification(reader: Reader) -> Specification:
    keys = reader.keys(
        "a specification",
        ("system",),
        ("topics", "resources", "environment", "components", "nodes", "constraints", "timing_seconds"),
    )
    name = keys["system"].name("the name of the system") if "system" in keys else None
    return Specification(
        name=name or "",
        connectors=Map(_named(keys, "topics", "topics", _connector)),
        components=Map(_named(keys, "components", "components", decode_component)),
        nodes=Map(_named(keys, "nodes", "nodes", _node)),
        environment=tuple(_named(keys, "environment", "guarantees of the environment", _offer).values()),
        resources=Map(_named(keys, "resources", "resources", _resource)),
        constraints=_constraints(keys["constraints"]) if "constraints" in keys else (),
        timing=Map(_timing(keys["timing_seconds"])) if "timing_seconds" in keys else Map(),
    )


def _named(keys: Mapping[str, Reader], key: str, what: str, decode: Callable[[Reader, str], Any]) -> dict[str, Any]:
    if key not in keys:
        return {}
    return {name: decode(reader, name) for name, reader in keys[key].entries(what)}


# -- contracts ---------------------------------------------------------------------------------------


def decode_predicate(reader: Reader) -> Predicate:
    return _predicate(reader, reader.keys("a predicate", ("type",), _PREDICATE))


def _predicate(reader: Reader, keys: Mapping[str, Reader]) -> Predicate:
    type_ = ""
    if "type" in keys and (text := keys["type"].text("a message type")) is not None:
        if is_message_type(text):
            type_ = text
        else:
            keys["type"].fault("E006", f"`{text}` is not a message type", "write it as `std_msgs/msg/String`")
    return Predicate(
        type=type_,
        rate=keys["rate"].number("a rate in Hz") if "rate" in keys else None,
        qos=_qos(keys["qos"]) if "qos" in keys else DEFAULT_QOS,
        fields=_fields(keys["where"]) if "where" in keys else (),
    )


def _qos(reader: Reader) -> QoS:
    known = [*_QOS_WORDS, *(f"{name}_seconds" for name in _QOS_SECONDS), "depth"]
    keys = reader.keys("a QoS profile", (), known)
    stated: dict[str, Any] = {
        name: keys[name].word(get_args(words)) for name, words in _QOS_WORDS.items() if name in keys
    }
    for name in _QOS_SECONDS:
        if f"{name}_seconds" in keys:
            stated[name] = keys[f"{name}_seconds"].number("a number of seconds")
    if "depth" in keys:
        stated["depth"] = keys["depth"].count("a depth")
    return QoS(**stated)


def _fields(reader: Reader) -> tuple[tuple[str, ValueSet], ...]:
    fields = []
    for path, entry in reader.entries("fields"):
        if not all(part.isidentifier() for part in path.split(".")):
            entry.fault("E006", f"`{path}` is not the path of a field", "write it as `header.frame_id`")
        fields.append((path, _values(entry)))
    return tuple(fields)


def _values(reader: Reader) -> ValueSet:
    keys = reader.keys("a field constraint", (), ("=", "in", ">=", ">", "<=", "<"))
    sets: list[ValueSet] = []
    for key, entry in keys.items():
        if key == "=":
            value = _scalar(entry)
            sets += [] if value is None else [OneOf.of([value])]
        elif key == "in":
            values = [_scalar(item) for item in entry.items("values")]
            sets += [OneOf.of(value for value in values if value is not None)]
        elif (bound := entry.finite("a number")) is not None:
            sets.append(
                Interval(low=bound, low_open=key == ">")
                if key[0] == ">"
                else Interval(high=bound, high_open=key == "<")
            )
    return reduce(_both, sets) if sets else Interval()


def _both(one: ValueSet, other: ValueSet) -> ValueSet:
    return one.intersection(other)


def _scalar(reader: Reader) -> Scalar | None:
    if isinstance(reader.value, (bool, str)):
        return reader.value
    if isinstance(reader.value, (int, float)):
        return reader.finite("a number")
    reader.fault("E001", f"a text, a number or a boolean is expected, this is {told(reader.value)}")
    return None


# -- components --------------------------------------------------------------------------------------


def decode_component(reader: Reader, name: str | None) -> ComponentSpec:
    """``name`` None: the document names itself."""
    optional = ("run", "takes_seconds", "holds", "parameters", "allows", "inputs", "outputs", "functionalities")
    keys = reader.keys("a component", () if name is not None else ("name",), optional)
    if name is None:
        name = (keys["name"].name("a name") if "name" in keys else None) or ""
    return ComponentSpec.of(
        name,
        inputs=_named(keys, "inputs", "inputs", lambda entry, _: decode_predicate(entry)),
        outputs=keys["outputs"].texts("names of outputs") if "outputs" in keys else (),
        functionalities=tuple(_named(keys, "functionalities", "functionalities", _functionality).values()),
        holds=_named(keys, "holds", "amounts", lambda entry, _: entry.number("an amount") or 0.0),
        parameters=_named(keys, "parameters", "parameters", lambda entry, _: _parameter(entry)),
        allows=tuple(_endpoint(item) for item in keys["allows"].items("endpoints")) if "allows" in keys else (),
        run=keys["run"].text("a command") if "run" in keys else None,
        takes=keys["takes_seconds"].number("a number of seconds", zero=True) if "takes_seconds" in keys else None,
    )


def _parameter(reader: Reader) -> ParameterSpec:
    keys = reader.keys("a parameter", ("value",), ("changeable",))
    value = _parameter_value(keys["value"]) if "value" in keys else None
    changeable = keys["changeable"].boolean() if "changeable" in keys else False
    return ParameterSpec("" if value is None else value, bool(changeable))


def _parameter_value(reader: Reader) -> ParameterValue | None:
    if not isinstance(reader.value, (list, tuple)):
        return _scalar(reader)
    values = [_scalar(item) for item in reader.items("values")]
    if None in values:
        return None
    kinds = {type(value) for value in values}
    if len(kinds) > 1:
        names = sorted({bool: "booleans", int: "integers", float: "reals", str: "texts"}[kind] for kind in kinds)
        reader.fault(
            "E001", f"the values of a list must be of one type, here are {' and '.join(names)}", "1.0 is a real"
        )
        return None
    return values  # type: ignore[return-value]  # just checked


def _endpoint(reader: Reader) -> Endpoint:
    keys = reader.keys("an allowed endpoint", ("kind", "name"), ())
    kind = keys["kind"].word(_ENDPOINTS) if "kind" in keys else None
    name = keys["name"].name("the name of an endpoint") if "name" in keys else None
    return Endpoint(kind or "", name or "")


def _functionality(reader: Reader, name: str) -> FunctionalitySpec:
    keys = reader.keys("a functionality", ("modes",), ("weight", "uses", "produces"))
    weight = keys["weight"].number("a weight", zero=True) if "weight" in keys else 1.0
    return FunctionalitySpec(
        name,
        modes=tuple(_named(keys, "modes", "modes", _mode).values()),
        inputs=keys["uses"].texts("names of inputs") if "uses" in keys else (),
        outputs=keys["produces"].texts("names of outputs") if "produces" in keys else (),
        weight=1.0 if weight is None else weight,
    )


def _mode(reader: Reader, name: str) -> Mode:
    keys = reader.keys("a mode", (), ("assumes", "guarantees"))
    assumptions = [_assumption(item) for item in keys["assumes"].items("assumptions")] if "assumes" in keys else []
    guarantees = _named(keys, "guarantees", "guarantees", lambda entry, _: decode_predicate(entry))
    return Mode(name, tuple(assumptions), Map(guarantees))


def _assumption(reader: Reader) -> Assumption:
    if isinstance(reader.value, str):
        return InputAlternatives((reader.name("the name of an input") or "",))
    if not isinstance(reader.value, dict):
        what = "the name of an input, an object with any_of, or a predicate"
        reader.fault("E001", f"an assumption ({what}) is expected, this is {told(reader.value)}")
        return InputAlternatives(())
    if "any_of" not in reader.value:
        return decode_predicate(reader)
    keys = reader.keys("an assumption of inputs", ("any_of",), ())
    names = keys["any_of"].texts("names of inputs")
    if keys["any_of"].value == []:
        keys["any_of"].fault("E001", "names of inputs are expected, this is an empty list")
    return InputAlternatives(names)


# -- systems -----------------------------------------------------------------------------------------


def _connector(reader: Reader, name: str) -> Connector:
    keys = reader.keys("a topic", ("type",), (*_PREDICATE, "max_publishers", "topic"))
    return Connector(
        name,
        _predicate(reader, keys),
        max_publishers=keys["max_publishers"].count("the number of publishers allowed", zero=True)
        if "max_publishers" in keys
        else None,
        topic=(keys["topic"].name("the name of a topic") if "topic" in keys else None) or "",
    )


def _offer(reader: Reader, name: str) -> EnvironmentGuarantee:
    keys = reader.keys("a guarantee of the environment", ("guarantee",), ("topic",))
    guarantee = decode_predicate(keys["guarantee"]) if "guarantee" in keys else Predicate("")
    return EnvironmentGuarantee(name, guarantee, keys["topic"].name("the name of a topic") if "topic" in keys else None)


def _resource(reader: Reader, name: str) -> Resource:
    keys = reader.keys("a resource", (), ("capacity",))
    capacity = keys["capacity"].number("a capacity") if "capacity" in keys else None
    return Resource(name, 1.0 if capacity is None else capacity)


def _node(reader: Reader, role: str) -> Node:
    keys = reader.keys("a node", ("component",), ("attachments", "parameters"))
    component = keys["component"].name("the name of a component") if "component" in keys else None
    attachments = _named(keys, "attachments", "attachments", lambda entry, _: entry.texts("names of topics"))
    parameters = _named(keys, "parameters", "values", lambda entry, _: _parameter_value(entry))
    return Node(
        role,
        component or "",
        Map(attachments),
        Map({name: value for name, value in parameters.items() if value is not None}),
    )


def _constraints(reader: Reader) -> tuple[Constraint, ...]:
    return tuple(_constraint(item) or Order("", "") for item in reader.items("constraints"))


def _constraint(reader: Reader) -> Constraint | None:
    forms = {"keep": "at", "limit": "below_baseline_seconds", "order": "before"}
    value = reader.value if isinstance(reader.value, dict) else {}
    form = next((name for name in forms if name in value), None)
    if form is None:
        wanted = "a constraint with `keep` and `at`, `limit` and `below_baseline_seconds`, or `order` and `before`"
        near = suggestion(next(iter(value)), forms) if value else ""
        reader.fault("E001", f"{wanted} is expected", near)
        return None
    keys = reader.keys(f"the constraint `{form}`", (form, forms[form]), ())
    first = keys[form].name("a name")
    if form == "limit":
        seconds = keys[forms[form]].number("a number of seconds", zero=True) if forms[form] in keys else None
        complete = first is not None and seconds is not None
        return Limit(FunctionalityRef.parse(first), seconds) if complete else None  # type: ignore[arg-type]
    second = keys[forms[form]].name("a name") if forms[form] in keys else None
    if first is None or second is None:
        return None
    return Order(first, second) if form == "order" else Keep(FunctionalityRef.parse(first), second)


def _timing(reader: Reader) -> dict[str, float]:
    keys = reader.keys("the timing of steps", (), tuple(DEFAULT_SECONDS))
    found = {kind: entry.number("a number of seconds", zero=True) for kind, entry in keys.items()}
    return {kind: seconds for kind, seconds in found.items() if seconds is not None}
