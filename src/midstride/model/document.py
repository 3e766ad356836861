"""The JSON form of components and specifications: plain dicts, lists, numbers and words, and back.

    {"system": "demo",
     "topics":      {"/chatter": {"type": "std_msgs/msg/String", "rate": 10, "qos": {"depth": 5}, "max_publishers": 1}},
     "resources":   {"gpu_memory": {"capacity": 8192}},
     "environment": {"camera": {"guarantee": {"type": …}}, "recording": {"guarantee": {…}, "topic": "/odom"}},
     "components":  {"Talker": {
         "run": "python3 -m demo.talker", "takes_seconds": 2, "holds": {"gpu_memory": 2048},
         "parameters": {"threshold": {"value": 0.4, "changeable": true}},
         "allows": [{"kind": "service", "name": "~/reset"}],
         "inputs": {"in": {"type": …, "rate": 5}}, "outputs": ["out"],
         "functionalities": {"talk": {"weight": 3, "uses": ["in"], "produces": ["out"], "modes": {
             "normal":   {"assumes": ["in", {"any_of": ["left", "right"]}, {"type": …}],
                          "guarantees": {"out": {"type": …, "rate": 10, "where": {"width": {">=": 640}}}}},
             "degraded": {}}}}}},
     "nodes":       {"talker": {"component": "Talker", "attachments": {"out": ["/chatter"]},
                                "parameters": {"threshold": 0.5}}},
     "constraints": [{"keep": "talker.talk", "at": "normal"}, {"limit": "talker.talk", "below_baseline_seconds": 2},
                     {"order": "talker", "before": "listener"}],
     "timing_seconds": {"create": 0.5}}

Rates are in Hz; what lasts says ``_seconds``. The order of ``modes`` is their rank, best first, and the
order of ports and functionalities is that of their declaration: do not sort keys. A field is constrained
with ``=``, ``in``, ``>=``, ``>``, ``<=``, ``<``, all of which hold together; ``{}`` is any number.
What is the default may be left out, and is left out here.

Reading reports every fault at once, as ``SpecificationError`` of :class:`~midstride.model.diagnostics.Problem`
values. It covers form and names; :mod:`midstride.model.specification_checks` judges the meaning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

from midstride.errors import SpecificationError
from midstride.model.component import (
    Assumption,
    ComponentSpec,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterValue,
)
from midstride.model.contract import Interval, OneOf, Predicate, QoS, ValueSet
from midstride.model.decoding import decode_component, decode_predicate, decode_specification
from midstride.model.diagnostics import Problem, independent
from midstride.model.name_checks import component_names, specification_names
from midstride.model.reading import Reader, parse_json
from midstride.model.specification import Constraint, Keep, Limit, Node, Specification

Document: TypeAlias = dict[str, Any]


# -- reading ---------------------------------------------------------------------------------------


def specification_from_document(document: object) -> Specification:
    """The specification a document says. Raises SpecificationError with every fault of form and of names."""
    faults: list[Problem] = []
    specification = decode_specification(Reader(document, (), faults))
    faults = independent(faults, specification_names(specification))
    if faults:
        raise SpecificationError(faults)
    return specification


def component_from_document(document: object) -> ComponentSpec:
    """The component that a document with a ``name`` says. Raises SpecificationError as above."""
    faults: list[Problem] = []
    component = decode_component(Reader(document, (), faults), None)
    faults = independent(faults, component_names(component, ()))
    if faults:
        raise SpecificationError(faults)
    return component


def predicate_from_document(document: object) -> Predicate:
    """The predicate a document says. Raises SpecificationError as above."""
    faults: list[Problem] = []
    predicate = decode_predicate(Reader(document, (), faults))
    if faults:
        raise SpecificationError(faults)
    return predicate


# -- writing ---------------------------------------------------------------------------------------


def specification_to_document(specification: Specification) -> Document:
    """The document of a specification; what is empty or the default is left out."""
    topics = {}
    for name, connector in sorted(specification.connectors.items()):
        topic = predicate_to_document(connector.guarantee)
        if connector.max_publishers is not None:
            topic["max_publishers"] = connector.max_publishers
        if connector.topic != name:
            topic["topic"] = connector.topic
        topics[name] = topic
    environment: Document = {}
    for offer in specification.environment:
        environment[offer.name] = {"guarantee": predicate_to_document(offer.guarantee)}
        if offer.topic is not None:
            environment[offer.name]["topic"] = offer.topic
    components = sorted(specification.components.items())
    return _stated(
        {
            "system": specification.name,
            "topics": topics,
            "resources": {
                name: {"capacity": _plain(r.capacity)} for name, r in sorted(specification.resources.items())
            },
            "environment": environment,
            "components": {name: _component_body(component) for name, component in components},
            "nodes": {role: _node(node, specification) for role, node in sorted(specification.nodes.items())},
            "constraints": [_constraint(constraint) for constraint in specification.constraints],
            "timing_seconds": {kind: _plain(seconds) for kind, seconds in sorted(specification.timing.items())},
        }
    )


def component_to_document(component: ComponentSpec) -> Document:
    """The document of one component by itself, its name in it."""
    return {"name": component.name, **_component_body(component)}


def predicate_to_document(predicate: Predicate) -> Document:
    """The document of a predicate: ``type``, and what else it states."""
    return _stated(
        {
            "type": predicate.type,
            "rate": None if predicate.rate is None else _plain(predicate.rate),
            "qos": _qos(predicate.qos),
            "where": {path: _values(values) for path, values in predicate.fields},
        }
    )


def _stated(document: Document) -> Document:
    """Without what is not stated: nulls, and what is empty."""
    return {key: value for key, value in document.items() if value is not None and value != {} and value != []}


def _plain(number: float) -> int | float:
    """A whole number without its ``.0``."""
    return int(number) if abs(number) < 2**53 and number == int(number) else number


def _qos(qos: QoS) -> Document:
    return _stated(
        {
            "reliability": qos.reliability,
            "durability": qos.durability,
            "deadline_seconds": None if qos.deadline is None else _plain(qos.deadline),
            "liveliness": qos.liveliness,
            "lease_seconds": None if qos.lease is None else _plain(qos.lease),
            "depth": qos.depth,
            "history": qos.history,
            "lifespan_seconds": None if qos.lifespan is None else _plain(qos.lifespan),
        }
    )


def _values(values: ValueSet) -> Document:
    if isinstance(values, OneOf):
        members = list(values.values)
        return {"=": members[0]} if len(members) == 1 else {"in": members}
    return _bounds(values)


def _bounds(interval: Interval) -> Document:
    bounds: Document = {}
    if not math.isinf(interval.low):
        bounds[">" if interval.low_open else ">="] = interval.low
    if not math.isinf(interval.high):
        bounds["<" if interval.high_open else "<="] = interval.high
    return bounds


def _component_body(component: ComponentSpec) -> Document:
    parameters: Document = {}
    for name, parameter in sorted(component.parameters.items()):
        parameters[name] = {"value": _value(parameter.value)}
        if parameter.changeable:
            parameters[name]["changeable"] = True
    return _stated(
        {
            "run": component.run,
            "takes_seconds": None if component.startup_seconds is None else _plain(component.startup_seconds),
            "holds": {name: _plain(amount) for name, amount in sorted(component.resource_usage.items())},
            "parameters": parameters,
            "allows": [{"kind": endpoint.kind, "name": endpoint.name} for endpoint in component.allows],
            "inputs": {name: predicate_to_document(component.inputs[name]) for name in component.input_order},
            "outputs": list(component.outputs),
            "functionalities": {functionality.name: _functionality(functionality) for functionality in component},
        }
    )


def _functionality(functionality: FunctionalitySpec) -> Document:
    stated = _stated(
        {
            "weight": None if functionality.weight == 1 else _plain(functionality.weight),
            "uses": list(functionality.inputs),
            "produces": list(functionality.outputs),
        }
    )
    return {**stated, "modes": {mode.name: _mode(mode, functionality) for mode in functionality.modes}}


def _mode(mode: Mode, functionality: FunctionalitySpec) -> Document:
    order = {name: index for index, name in enumerate(functionality.outputs)}
    outputs = sorted(mode.guarantees, key=lambda name: (order.get(name, len(order)), name))
    return _stated(
        {
            "assumes": [_assumption(assumption) for assumption in mode.assumptions],
            "guarantees": {name: predicate_to_document(mode.guarantees[name]) for name in outputs},
        }
    )


def _assumption(assumption: Assumption) -> str | Document:
    if isinstance(assumption, InputAlternatives):
        return assumption.inputs[0] if len(assumption.inputs) == 1 else {"any_of": list(assumption.inputs)}
    return predicate_to_document(assumption)


def _value(value: ParameterValue) -> Any:
    return list(value) if isinstance(value, list) else value


def parameters_to_document(parameters: Mapping[str, ParameterValue]) -> Document:
    """The values of parameters, by name."""
    return {name: _value(value) for name, value in sorted(parameters.items())}


def _node(node: Node, specification: Specification) -> Document:
    component = specification.components.get(node.component)
    order = {} if component is None else {name: index for index, name in enumerate(component.ports())}
    ports = sorted(node.attachments, key=lambda name: (order.get(name, len(order)), name))
    stated = _stated(
        {
            "attachments": {name: list(node.attachments[name]) for name in ports if node.attachments[name]},
            "parameters": parameters_to_document(node.parameters),
        }
    )
    return {"component": node.component, **stated}


def _constraint(constraint: Constraint) -> Document:
    if isinstance(constraint, Keep):
        return {"keep": str(constraint.functionality), "at": constraint.mode}
    if isinstance(constraint, Limit):
        return {"limit": str(constraint.functionality), "below_baseline_seconds": _plain(constraint.seconds)}
    return {"order": constraint.first, "before": constraint.then}


__all__ = [
    "Document",
    "component_from_document",
    "component_to_document",
    "parse_json",
    "predicate_from_document",
    "predicate_to_document",
    "specification_from_document",
    "specification_to_document",
]
