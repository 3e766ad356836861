"""A specification as a Stride text: slow and obvious, for comparison with what the language reads from it."""

from __future__ import annotations

from collections.abc import Iterator

from midstride.model.component import ComponentSpec, FunctionalitySpec, ParameterValue
from midstride.model.specification import Node, Specification
from midstride.model.wording import KIND_WORDS


def stride(specification: Specification) -> str:
    """What declares the specification, if it has what ``tests.strategies.systems`` draws; one statement a line."""
    return "\n".join(_lines(specification)) + "\n"


def _lines(specification: Specification) -> Iterator[str]:
    yield f"system {specification.name}"
    for resource in specification.resources.values():
        yield f"resource {resource.name} = {resource.capacity!r}"
    for name, connector in specification.connectors.items():
        limited = connector.kind == "topic" and connector.max_publishers is not None
        limit = f" {{ publishers <= {connector.max_publishers} }}" if limited else ""
        yield f"{connector.kind} {name} : {connector.guarantee}{limit}"
    yield "environment {"
    for offer in specification.environment:
        yield f"guarantee {offer.name}{f' on {offer.topic}' if offer.topic else ''} : {offer.guarantee}"
    yield "}"
    for component in specification.components.values():
        yield from _component(component)
    for node in specification.nodes.values():
        yield from _node(node, specification.component_of(node.role))
    yield from map(str, specification.constraints)
    yield "timing {"
    yield from (f"{step} {seconds!r} s" for step, seconds in specification.timing.items())
    yield "}"


def _component(component: ComponentSpec) -> Iterator[str]:
    yield f"component {component.name} {{"
    if component.resource_usage:
        yield f"holds {', '.join(f'{name} {amount!r}' for name, amount in component.resource_usage.items())}"
    yield "parameters {"
    for name, parameter in component.parameters.items():
        yield f"{'changeable ' * parameter.changeable}{name} = {_value(parameter.value)}"
    yield "}"
    for port in component.ports():
        words = KIND_WORDS[component.kind_of(port)]
        if component.has_output(port):
            yield f"{words.output} {port}"
        else:
            tolerated = f" tolerates {component.tolerates[port]} missed" if port in component.tolerates else ""
            yield f"{words.input} {port} : {component.inputs[port]}{tolerated}"
    for functionality in component:
        yield from _functionality(functionality)
    yield "}"


def _functionality(functionality: FunctionalitySpec) -> Iterator[str]:
    yield f"functionality {functionality.name} weight {functionality.weight!r} {{"
    if functionality.inputs:
        yield f"uses {', '.join(functionality.inputs)}"
    if functionality.outputs:
        yield f"produces {', '.join(functionality.outputs)}"
    for mode in functionality.modes:
        yield f"mode {mode.name} {{"
        yield from (f"assume {assumption}" for assumption in mode.assumptions)
        yield from (f"guarantee {output} : {contract}" for output, contract in mode.guarantees.items())
        yield "}"
    yield "}"


def _node(node: Node, component: ComponentSpec) -> Iterator[str]:
    yield f"node {node.role} : {component.name} {{"
    yield f"parameters {{ {' '.join(f'{name} = {_value(value)}' for name, value in node.parameters.items())} }}"
    for port, topics in node.attachments.items():
        yield f"{port} {'->' if component.has_output(port) else '<-'} {', '.join(topics)}"
    yield "}"


def _value(value: ParameterValue) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)
