"""An author's declaration of a component, and the model's component made of it, checked against the model's rules."""

from __future__ import annotations

import itertools
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from immutables import Map

from midstride.errors import NodeError
from midstride.model import component as model
from midstride.model.contract import NOTHING, Predicate, explain, satisfies
from midstride.model.wording import KIND_WORDS
from midstride.node.author.client_ports import ClientPort
from midstride.node.author.declared_parameters import Parameter
from midstride.node.author.functionality import Functionality
from midstride.node.author.modes import DeclaredMode
from midstride.node.author.ports import Input, Output
from midstride.node.author.server_ports import ServerPort
from midstride.wire import replies
from midstride.wire.commands import SetParametersCommand


class OutsideState(Protocol):
    """The state of a program outside, which the component passes on (:mod:`midstride.foreign.relayed_state`).

    On the control thread. Each method raises CommandRefused where the program does not do it, and says why.
    """

    exports: bool

    async def require_import(self) -> None:
        """Look whether the program imports state."""

    async def exported(self, timeout: float) -> replies.ExportedState:
        """The state, or that the program has not answered in ``timeout`` (s)."""

    async def import_(self, state: bytes, timeout: float) -> None:
        """Have the program take over ``state``, in ``timeout`` (s).

        Raises ImportRefused where it refuses; where it may do so yet, CommandRefused.
        """


@dataclass(slots=True)
class Callbacks:
    """The author's functions that are called besides those of modes."""

    setup: Callable[[Any], None] | None = None
    stop: Callable[[], Any] | None = None
    stop_timeout: float = 2.0
    export_state: Callable[[], bytes] | None = None
    import_state: Callable[[bytes], None] | None = None
    export_changes: Callable[[], bytes] | None = None
    import_changes: Callable[[bytes], None] | None = None
    # What must be done before functionalities enter modes (by name). On the control thread; raises CommandRefused.
    before_modes: Callable[[Mapping[str, str]], Awaitable[None]] | None = None
    # Sets parameters where they are not the component's own. On the control thread; raises CommandRefused.
    set_parameters: Callable[[SetParametersCommand], Awaitable[replies.PreviousParameters]] | None = None
    # The state, where it is not the component's own.
    outside_state: OutsideState | None = None


@dataclass(frozen=True, slots=True)
class DeclaredParts:
    """By name, in order of declaration. Complete once the component starts."""

    inputs: dict[str, Input] = field(default_factory=dict)
    outputs: dict[str, Output] = field(default_factory=dict)
    functionalities: dict[str, Functionality] = field(default_factory=dict)
    parameters: dict[str, Parameter] = field(default_factory=dict)
    callbacks: Callbacks = field(default_factory=Callbacks)

    @property
    def ports(self) -> dict[str, Output | Input]:
        return {**self.outputs, **self.inputs}

    @property
    def services(self) -> list[ServerPort | ClientPort]:
        """The servers and clients."""
        return [port for port in self.ports.values() if isinstance(port, ServerPort | ClientPort)]


def declare(name: str, parts: DeclaredParts) -> model.ComponentSpec:
    """The component. Raises NodeError where it breaks a rule of docs/semantics.md section 2."""
    if not parts.functionalities:
        raise NodeError("the component has no functionality; write create_functionality(…) and give it modes")
    owned = {port for functionality in parts.functionalities.values() for port in functionality.outputs}
    for port in parts.outputs.values():
        if port not in owned:
            raise NodeError(
                f"{'server' if isinstance(port, ServerPort) else 'output'} {port.name} belongs to no functionality; "
                f"write create_functionality(…, outputs=[{port.name}])"
            )
    callbacks = parts.callbacks
    if callbacks.export_changes is not None and callbacks.export_state is None:
        raise NodeError("on_export_changes() adds to what on_export_state() exports; declare that as well")
    if callbacks.import_changes is not None and callbacks.import_state is None:
        raise NodeError("on_import_changes() adds to what on_import_state() imports; declare that as well")
    return model.ComponentSpec.of(
        name,
        inputs={name: port.assumption for name, port in parts.inputs.items()},
        tolerates={name: port.tolerates for name, port in parts.inputs.items() if port.tolerates is not None},
        conditions=[name for name, port in parts.inputs.items() if port.condition],
        outputs=tuple(parts.outputs),
        functionalities=tuple(map(_functionality, parts.functionalities.values())),
        parameters={
            name: model.ParameterSpec(parameter.value, parameter.on_change is not None)
            for name, parameter in parts.parameters.items()
        },
    )


def _functionality(functionality: Functionality) -> model.FunctionalitySpec:
    modes = tuple(map(_mode, functionality.chain()))
    _check_monotonic(functionality, modes)
    return model.FunctionalitySpec(
        functionality.name,
        modes,
        tuple(port.name for port in functionality.inputs),
        tuple(port.name for port in functionality.outputs),
        functionality.weight,
    )


def _mode(mode: DeclaredMode) -> model.Mode:
    guarantees: dict[str, Predicate] = {}
    for port in mode.outputs:
        # A rate-driven mode guarantees its rate; a message-driven one guarantees only what is stated.
        guarantees[port.name] = port.guaranteed(mode.promise(port))
    assumptions = tuple(
        model.InputAlternatives(tuple(port.name for port in alternatives)) for alternatives in mode.assumptions
    )
    return model.Mode(mode.name, assumptions, Map(guarantees))


def _check_monotonic(functionality: Functionality, modes: tuple[model.Mode, ...]) -> None:
    """Rule M2: every better mode guarantees what a worse one guarantees."""
    for better, worse in itertools.pairwise(modes):
        for port in functionality.outputs:
            needed, offered = worse.guarantee(port.name), better.guarantee(port.name)
            if needed is NOTHING or satisfies(offered, needed):
                continue
            what = KIND_WORDS[needed.kind].output
            raise NodeError(
                f"functionality {functionality.name}: mode {worse.name} guarantees {needed} on {what} {port.name}, and "
                f"the better mode {better.name} does not ({', '.join(explain(offered, needed))}); a better mode must "
                f"guarantee at least as much: add the output to outputs=, or state it in guarantees="
            )
