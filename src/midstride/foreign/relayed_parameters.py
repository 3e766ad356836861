"""The parameters of the program behind a relay, which its relay reads and sets, and reports as the instance's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from msgspec import structs

from midstride.foreign.foreign_parameters import ForeignParameters
from midstride.foreign.services import ParameterAccess
from midstride.model.component import ComponentSpec
from midstride.wire import commands, replies
from midstride.wire.state import ComponentState

# How often the node is asked for its parameters (s).
PARAMETERS_LOOK: Final = 2.0


@dataclass(frozen=True, slots=True)
class RelayedRecord:
    """The record of a program behind a relay: a ``ParameterRecord`` in no file, as the program ends with its relay."""

    instance: str
    node: str
    stated: dict[str, Any]
    taken_over: dict[str, Any]
    modes: Mapping[str, str]
    started_with: dict[str, Any] | None = None
    requested: list[str] = field(default_factory=list)


@dataclass
class RelayedNode:
    """The node of the program: its parameters as of the last time that it was asked."""

    component: ComponentSpec
    record: RelayedRecord
    parameters: dict[str, Any] = field(default_factory=dict)
    declared: dict[str, Any] = field(default_factory=dict)
    unread_parameters: bool = False

    def change_record(self, **changes: Any) -> None:
        self.record = replace(self.record, **changes)

    def note_settings(self) -> None:
        """Nothing: no library notes the requests to a program behind a relay."""


class RelayedParameters:
    """The parameters of ``node``, read and set by its own ``services``."""

    def __init__(self, node: RelayedNode, services: ParameterAccess) -> None:
        self._node = node
        self._parameters = ForeignParameters(node, services)

    async def look(self) -> bool:
        """Ask the node; return whether anything has changed."""
        before = self._seen()
        await self._parameters.read()
        return before != self._seen()

    async def refresh(self) -> None:
        """Ask the node, unless it has not answered when it was last asked."""
        if not self._node.unread_parameters:
            await self._parameters.read()

    def _seen(self) -> tuple[object, ...]:
        node = self._node
        return node.parameters, node.declared, node.unread_parameters

    async def set(self, command: commands.SetParametersCommand, modes: Mapping[str, str]) -> replies.PreviousParameters:
        """All of them or none, while these ``modes`` (by functionality) are in force. Raises CommandRefused."""
        self._node.change_record(modes=modes)
        return await self._parameters.set(command)

    async def enter_modes(self, modes: Mapping[str, str]) -> None:
        """Set what these modes (by functionality) state. Raises CommandRefused with the node's reason."""
        await self._parameters.enter_modes(modes)

    def shown_in(self, state: ComponentState) -> ComponentState:
        """The ``state`` of the relay, with the parameters of the node instead of its own."""
        node = self._node
        return structs.replace(
            state,
            parameters=node.parameters,
            declared=node.declared,
            unread_parameters=node.unread_parameters,
            unknown_origin=[name for name in node.declared if name not in node.record.requested],
        )
