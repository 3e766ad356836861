"""Modes as sets of parameters, for programs that do not use Midstride's API (docs/protocols/modes.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from midstride.codec.parameter import from_json
from midstride.errors import CommandRefused
from midstride.foreign.services import NoAnswer, ParameterSetter
from midstride.model.component import ComponentSpec, ParameterValue
from midstride.node.author.declared_parameters import fitted_to

# How long the node may take to set its parameters (s).
SET_TIMEOUT: Final = 4.0


class NotAnswered(CommandRefused):
    """The node has not answered: whether it has set its parameters, or will, is not known."""


def on_entry(
    component: ComponentSpec, modes: Mapping[str, str], stated: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return the parameters that are set when ``modes`` (by functionality) are entered.

    ``stated``: the values of the node in the specification, which come before those of its component.
    """
    values = {name: declared.value for name, declared in component.parameters.items()} | dict(stated)
    found: dict[str, ParameterValue] = {}
    for name, mode in modes.items():
        functionality = component.functionalities[name]
        found |= functionality.on_entry(functionality.modes[functionality.mode_index(mode)], values)
    return found


async def set_parameters(
    services: ParameterSetter,
    instance: str,
    component: ComponentSpec,
    values: Mapping[str, Any],
    known: Mapping[str, Any] | None = None,
    timeout: float = SET_TIMEOUT,
) -> None:
    """Set all of these in ``timeout`` (s), or none. ``known``: the parameters of the node, where it has said them.

    Raises CommandRefused with the node's reason, or NotAnswered.
    """
    if not values:
        return
    values = {name: from_json(value) for name, value in values.items()}
    what = ", ".join(f"{name} = {value!r}" for name, value in values.items())
    try:
        refused = await services.set_parameters(typed(component, values, known or {}), timeout)
    except NoAnswer as error:
        raise NotAnswered(f"{instance} has not set {what}: {error}") from None
    if refused is not None:
        raise CommandRefused(f"{instance} refuses {what}: {refused or 'it gives no reason'}")


def typed(component: ComponentSpec, values: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """An integer as a float where that is the parameter's type: a specification may state `1` for `1.0`.

    ``known``: the parameters of the node, where it has said them.
    """
    declared = component.parameters
    known = {name: from_json(value) for name, value in known.items()}

    def as_declared(name: str, value: Any) -> Any:
        fitted = fitted_to(value, known.get(name, declared[name].value if name in declared else None))
        return value if fitted is None else fitted

    return {name: as_declared(name, value) for name, value in values.items()}
