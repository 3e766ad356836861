"""The parameters of a foreign node: as they are now, and which of them were set while it ran."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from midstride.foreign.mode_parameters import on_entry, set_parameters
from midstride.foreign.node import ForeignNode
from midstride.foreign.services import NoAnswer, NodeServices
from midstride.wire import commands, replies

# How long the node may take to say the values of its parameters (s).
READ_TIMEOUT: Final = 1.0
# Parameters that ROS 2 itself declares, and that cannot be set.
_OF_ROS: Final = ("qos_overrides.", "start_type_description_service")


class ForeignParameters:
    """The ROS parameters of ``node``, which are in its state as of the last :meth:`read`."""

    def __init__(self, node: ForeignNode, services: NodeServices) -> None:
        self._node = node
        self._services = services

    async def read(self) -> None:
        """Have the state show them, or that the node does not answer."""
        try:
            found = await self._services.parameters(READ_TIMEOUT)
        except NoAnswer:
            self._node.unread_parameters = True
            return
        self._node.unread_parameters = False
        values = {name: value for name, value in found.items() if not name.startswith(_OF_ROS)}
        record = self._node.record
        # What the program itself has chosen is not known before; and one that is no lifecycle node, which has answered
        # before it was complete, may declare more.
        late = {} if self._node.component.has_lifecycle else values
        own = {name: value for name, value in values.items() if name not in record.taken_over}
        if record.started_with is None:
            first = {**own, **record.stated} if self._node.component.has_lifecycle else {**record.stated, **own}
            self._node.change_record(started_with=first)
        elif new := {name: own[name] for name in own if name in late and name not in record.started_with}:
            self._node.change_record(started_with={**record.started_with, **new})
        started_with = self._node.record.started_with or {}
        of_modes = {name for functionality in self._node.component for name in functionality.parameters()}
        self._node.parameters = values
        self._node.declared = {
            name: started_with.get(name, value)
            for name, value in values.items()
            if name not in of_modes and (name not in started_with or started_with[name] != value)
        }

    async def set(self, command: commands.SetParametersCommand) -> replies.PreviousParameters:
        """All of them or none; those that have their value already are not set. Raises CommandRefused."""
        await self.read()
        before, declared = dict(self._node.parameters), dict(self._node.declared)
        changed = {name: value for name, value in command.parameters.items() if before.get(name) != value}
        await self.apply(changed)
        stated = command.parameters if command.declared is None else command.declared
        self._node.change_record(started_with={**(self._node.record.started_with or {}), **stated})
        await self.read()
        names = command.parameters.keys()
        return replies.PreviousParameters(
            before={name: before[name] for name in names if name in before},
            declared={name: declared[name] for name in names if name in declared},
        )

    async def enter_modes(self, modes: Mapping[str, str]) -> None:
        """Set what these modes (by functionality) state. Raises CommandRefused with the node's reason."""
        await self.apply(on_entry(self._node.component, modes, self._node.record.stated))

    async def apply(self, values: Mapping[str, Any]) -> None:
        """Set all of these, or none. Raises CommandRefused with the node's reason."""
        node = self._node
        await set_parameters(self._services, node.record.instance, node.component, values, node.parameters)
