"""From what an author declared to the model's component, checked against the model's rules."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from immutables import Map

from midstride.errors import NodeError
from midstride.model import component as model
from midstride.model.contract import NOTHING, Predicate, explain, satisfies
from midstride.node.contracts import Guarantee, predicate
from midstride.node.functionality import Functionality
from midstride.node.modes import DeclaredMode
from midstride.node.parameters import Parameter
from midstride.node.ports import Input, Output


def declare(
    name: str,
    inputs: Sequence[Input],
    outputs: Sequence[Output],
    functionalities: Sequence[Functionality],
    parameters: Sequence[Parameter],
) -> model.ComponentSpec:
    """The component. Raises NodeError where it breaks a rule of docs/semantics.md section 2."""
    _check_owned(outputs, functionalities)
    return model.ComponentSpec.of(
        name,
        inputs={port.name: port.assumption for port in inputs},
        outputs=tuple(port.name for port in outputs),
        functionalities=tuple(_functionality(functionality) for functionality in functionalities),
        parameters={p.name: model.ParameterSpec(p.value, p.on_change is not None) for p in parameters},
    )


def _check_owned(outputs: Sequence[Output], functionalities: Sequence[Functionality]) -> None:
    if not functionalities:
        raise NodeError("the component has no functionality; write create_functionality(…) and give it modes")
    owned = {port for functionality in functionalities for port in functionality.outputs}
    for port in outputs:
        if port not in owned:
            raise NodeError(
                f"output {port.name} belongs to no functionality; write create_functionality(…, outputs=[{port.name}])"
            )


def _functionality(functionality: Functionality) -> model.FunctionalitySpec:
    declared = functionality.chain()
    modes = tuple(_mode(mode) for mode in declared)
    _check_monotonic(functionality, modes)
    return model.FunctionalitySpec(
        functionality.name,
        modes,
        tuple(port.name for port in functionality.inputs),
        tuple(port.name for port in functionality.outputs),
        functionality.weight,
    )


def _mode(mode: DeclaredMode) -> model.Mode:
    guarantees = {port.name: _guarantee(mode, port) for port in mode.outputs}
    assumptions = tuple(
        model.InputAlternatives(tuple(port.name for port in alternatives)) for alternatives in mode.assumptions
    )
    return model.Mode(mode.name, assumptions, Map(guarantees))


def _guarantee(mode: DeclaredMode, port: Output) -> Predicate:
    """A rate-driven mode guarantees its rate; a message-driven one guarantees only what is stated."""
    stated = mode.guarantees.get(port, Guarantee(None, ()))
    rate = mode.rate if stated.rate is None else stated.rate
    return predicate(port.type, rate, port.qos, stated.where)


def _check_monotonic(functionality: Functionality, modes: tuple[model.Mode, ...]) -> None:
    """Rule M2: every better mode guarantees what a worse one guarantees."""
    for better, worse in itertools.pairwise(modes):
        for port in functionality.outputs:
            needed, offered = worse.guarantee(port.name), better.guarantee(port.name)
            if needed is NOTHING or satisfies(offered, needed):
                continue
            raise NodeError(
                f"functionality {functionality.name}: mode {worse.name} guarantees {needed} on output {port.name}, and "
                f"the better mode {better.name} does not ({', '.join(explain(offered, needed))}); a better mode must "
                f"guarantee at least as much: add the output to outputs=, or state it in guarantees="
            )
