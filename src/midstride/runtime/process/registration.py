"""Checks that a component that registered matches its declaration in the specification.

In the paper (section 5.2) nodes register their model with the management node. Here a registration must match the
specification: the same ports and functionalities, guarantees at least as strong, assumptions no stronger.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Final, Literal

from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import NOTHING, Contract, Predicate, explain, format_number
from midstride.model.graph_names import resolved
from midstride.wire.state import Endpoint


def mismatches(declared: ComponentSpec, registered: ComponentSpec) -> list[str]:
    """Every way in which ``registered`` violates the declaration; empty iff it matches."""
    found = [
        *_names(declared.input_order, registered.input_order, declared.port_in_words, registered.port_in_words),
        *_names(declared.outputs, registered.outputs, declared.port_in_words, registered.port_in_words),
        *_names(declared.functionality_order, registered.functionality_order, _of_functionality, _of_functionality),
    ]
    for name in declared.input_order:
        needed, ours = declared.inputs[name], registered.inputs.get(name)
        if ours is not None and (clauses := explain(needed, ours)):
            assumed = f"{registered.port_in_words(name)} assumes {ours}"
            found.append(f"{assumed}, more than the declared {needed} ({', '.join(clauses)})")
    for functionality in declared:
        if (theirs := registered.functionalities.get(functionality.name)) is not None:
            found += _functionality(declared, functionality, theirs)
    return found


# The kinds of the specification as nodes report them: `action` is a word of plans.
REPORTED: Final[Mapping[str, Literal["topic", "service", "ROS action"]]] = {
    "topic": "topic",
    "service": "service",
    "action": "ROS action",
}


def unexpected_endpoints(declared: ComponentSpec, nodes: Collection[str], endpoints: Sequence[Endpoint]) -> list[str]:
    """The endpoints of a node, other than ports, that its component does not ``allow``.

    ``nodes``: the names that the node may have, of its role or of its instance.
    """
    allowed = {
        (REPORTED[endpoint.kind], resolved(endpoint.name, node)) for endpoint in declared.allows for node in nodes
    }
    return [
        f"{endpoint.kind} {endpoint.name}"
        for endpoint in endpoints
        if allowed.isdisjoint(
            {(endpoint.kind, endpoint.name), *((endpoint.kind, resolved(endpoint.name, node)) for node in nodes)}
        )
    ]


def _of_functionality(name: str) -> str:
    return f"functionality {name}"


def _names(
    declared: Sequence[str],
    registered: Sequence[str],
    declared_in_words: Callable[[str], str],
    registered_in_words: Callable[[str], str],
) -> Iterator[str]:
    for name in declared:
        if name not in registered:
            yield f"{declared_in_words(name)} is declared, but the node does not have it"
    for name in registered:
        if name not in declared:
            yield f"the node has {registered_in_words(name)}, which is not declared"


def _functionality(
    component: ComponentSpec, declared: FunctionalitySpec, registered: FunctionalitySpec
) -> Iterator[str]:
    for kind, ours, theirs in (
        ("input", declared.inputs, registered.inputs),
        ("output", declared.outputs, registered.outputs),
    ):
        if set(ours) != set(theirs):
            lists = f"{', '.join(theirs) or 'none'} instead of {', '.join(ours) or 'none'}"
            yield f"functionality {declared.name} is associated with other {kind}s: {lists}"
    names, own = [mode.name for mode in declared.modes], [mode.name for mode in registered.modes]
    if names != own:
        yield f"functionality {declared.name} has the modes {', '.join(own)} instead of {', '.join(names)}"
        return
    for promised, kept in zip(declared.modes, registered.modes, strict=True):
        where = f"{declared.name} in mode {promised.name}"
        for output in declared.outputs:
            guarantee, own_guarantee = promised.guarantee(output), kept.guarantee(output)
            if guarantee is not NOTHING and (clauses := explain(own_guarantee, guarantee)):
                said = f"{where} guarantees {own_guarantee} on {output} instead of {guarantee} ({', '.join(clauses)})"
                yield said + _remedy(output, own_guarantee, guarantee)
        yield from _assumptions(component, declared, where, promised, kept)


def _remedy(output: str, own: Contract, needed: Contract) -> str:
    """Say what to write in the code of a mode that states nothing, or no rate, of ``output``."""
    if own is NOTHING:
        return f"; name it in the mode's outputs=[{output}]"
    if not isinstance(needed, Predicate):
        return ""
    if own.rate is None and needed.rate is not None:
        rate = format_number(needed.rate)
        return (
            f"; state it in the mode's guarantees={{{output}: {rate}}}, or have the mode called at it by rate={rate}, "
            "or leave the rate out of the specification"
        )
    return ""


def _assumptions(
    component: ComponentSpec, declared: FunctionalitySpec, where: str, promised: Mode, kept: Mode
) -> Iterator[str]:
    """The node may assume less than is declared, not more: a declared assumption must imply each of the node's."""
    alternatives = [_alternatives(component, declared, assumption) for assumption in promised.assumptions]
    for assumption in kept.assumptions:
        own = _alternatives(component, declared, assumption)
        if not any(options and options <= own for options in alternatives):
            yield f"{where} assumes {assumption}, which is not declared"


def _alternatives(
    component: ComponentSpec, functionality: FunctionalitySpec, assumption: InputAlternatives | Predicate
) -> set[str]:
    if isinstance(assumption, InputAlternatives):
        return set(assumption.inputs)
    return {name for name in functionality.inputs if not explain(component.inputs[name], assumption)}
