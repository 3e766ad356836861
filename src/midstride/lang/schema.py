"""The JSON Schema (draft 2020-12) of the JSON form of specifications (:mod:`midstride.model.document`).

It says the form: keys, types of values, ranges, shapes of names. That names are declared and contracts satisfied no
schema can say: `midstride check` does.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias, get_args

from midstride.model.contract import Durability, History, Liveliness, Reliability
from midstride.model.specification import DEFAULT_SECONDS

Schema: TypeAlias = dict[str, Any]

_TOKEN: Final = "[A-Za-z_][A-Za-z0-9_]*"
_POSITIVE: Final[Schema] = {"type": "number", "exclusiveMinimum": 0}
_NOT_NEGATIVE: Final[Schema] = {"type": "number", "minimum": 0}
_SCALAR: Final[Schema] = {"type": ["string", "number", "boolean"]}
_NAME: Final[Schema] = {"type": "string", "minLength": 1}  # of something declared elsewhere
_DECLARED: Final[Schema] = {"type": "string", "pattern": f"^{_TOKEN}$", "maxLength": 255}
_TEXTS: Final[Schema] = {"type": "array", "items": _NAME}


def _object(properties: Schema, required: tuple[str, ...] = (), about: str = "") -> Schema:
    schema: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    if required:
        schema["required"] = list(required)
    if about:
        schema["description"] = about
    return schema


def _map(values: Schema, about: str, names: str | None = None) -> Schema:
    schema: Schema = {"type": "object", "additionalProperties": values, "description": about}
    if names is not None:
        schema["propertyNames"] = {"pattern": f"^{names}$", "maxLength": 255}
    return schema


def _ref(name: str) -> Schema:
    return {"$ref": f"#/$defs/{name}"}


def _word(words: object) -> Schema:
    return {"enum": list(get_args(words))}


_PREDICATE: Final[Schema] = {
    "type": {
        "type": "string",
        "pattern": f"^{_TOKEN}/(msg/)?{_TOKEN}$",
        "description": "the message type, pkg/msg/Type or pkg/Type",
    },
    "rate": {**_POSITIVE, "description": "in Hz, at least"},
    "qos": _ref("qos"),
    "where": _map(_ref("values"), "the values that fields may have, by dotted path"),
}

_DEFINITIONS: Final[Schema] = {
    "predicate": _object(_PREDICATE, ("type",), "what messages are like: a guarantee, or an assumption"),
    "qos": _object(
        {
            "reliability": _word(Reliability),
            "durability": _word(Durability),
            "liveliness": _word(Liveliness),
            "history": _word(History),
            "depth": {"type": "integer", "minimum": 1},
            "deadline_seconds": _POSITIVE,
            "lease_seconds": _POSITIVE,
            "lifespan_seconds": _POSITIVE,
        },
        about="a QoS profile; what is not stated is ROS 2's default",
    ),
    "values": _object(
        {
            "=": _SCALAR,
            "in": {"type": "array", "items": _SCALAR},
            **{sign: {"type": "number"} for sign in (">=", ">", "<=", "<")},
        },
        about="a set of values: all that is stated holds",
    ),
    "value": {
        "description": "the value of a parameter; a list is of one kind",
        "anyOf": [_SCALAR, *({"type": "array", "items": {"type": kind}} for kind in ("string", "number", "boolean"))],
    },
    "component": _object(
        {
            "run": {"type": "string", "description": "the command that is this component; none: started elsewhere"},
            "takes_seconds": {**_NOT_NEGATIVE, "description": "how long its creation takes"},
            "holds": _map(_POSITIVE, "what it holds of resources"),
            "parameters": _map(
                _object({"value": _ref("value"), "changeable": {"type": "boolean"}}, ("value",)),
                "its parameters, and whether they can be set in place",
            ),
            "allows": {
                "type": "array",
                "items": _object({"kind": {"enum": ["topic", "service", "action"]}, "name": _NAME}, ("kind", "name")),
            },
            "inputs": _map(_ref("predicate"), "what it relies on each input for", _TOKEN),
            "outputs": {"type": "array", "items": _DECLARED, "description": "the names of its outputs"},
            "functionalities": _map(_ref("functionality"), "what it does", _TOKEN),
        }
    ),
    "functionality": _object(
        {
            "weight": _NOT_NEGATIVE,
            "uses": {**_TEXTS, "description": "its inputs"},
            "produces": {**_TEXTS, "description": "its outputs"},
            "modes": _map(_ref("mode"), "its modes, best first", _TOKEN),
        },
        ("modes",),
    ),
    "mode": _object(
        {
            "assumes": {"type": "array", "items": _ref("assumption")},
            "guarantees": _map(_ref("predicate"), "what it guarantees on outputs; those left out produce nothing"),
        }
    ),
    "assumption": {
        "anyOf": [
            {**_NAME, "description": "an input"},
            _object({"any_of": {**_TEXTS, "minItems": 1}}, ("any_of",), "one of several inputs"),
            _ref("predicate"),
        ]
    },
    "topic": _object(
        {
            **_PREDICATE,
            "max_publishers": {"type": "integer", "minimum": 0},
            "topic": {**_NAME, "description": "the name on the wire, where it differs"},
        },
        ("type",),
    ),
    "offer": _object(
        {"guarantee": _ref("predicate"), "topic": _NAME},
        ("guarantee",),
        "what the environment guarantees; with a topic, as a publisher of it",
    ),
    "node": _object(
        {
            "component": _NAME,
            "attachments": _map(_TEXTS, "the topics of each port"),
            "parameters": _map(_ref("value"), "its own values, over its component's"),
        },
        ("component",),
    ),
    "constraint": {
        "anyOf": [
            _object({"keep": _NAME, "at": _NAME}, ("keep", "at")),
            _object(
                {"limit": _NAME, "below_baseline_seconds": _NOT_NEGATIVE},
                ("limit", "below_baseline_seconds"),
            ),
            _object({"order": _NAME, "before": _NAME}, ("order", "before")),
        ]
    },
}


def schema() -> Schema:
    """The schema of a whole specification."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Midstride specification",
        **_object(
            {
                "system": _DECLARED,
                "topics": _map(_ref("topic"), "the topics, by full name"),
                "resources": _map(_object({"capacity": _POSITIVE}), "what there is only so much of"),
                "environment": _map(_ref("offer"), "what there is without anyone's doing", _TOKEN),
                "components": _map(_ref("component"), "kinds of nodes", _TOKEN),
                "nodes": _map(_ref("node"), "the nodes, by name, namespaces in front", f"/?{_TOKEN}(/{_TOKEN})*"),
                "constraints": {"type": "array", "items": _ref("constraint")},
                "timing_seconds": _object(
                    dict.fromkeys(sorted(DEFAULT_SECONDS), _NOT_NEGATIVE), about="how long steps take, where known"
                ),
            },
            ("system",),
        ),
        "$defs": _DEFINITIONS,
    }
