"""The parameters of a foreign node: as they are now, and which of them were set while it ran."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Final, Protocol

from midstride.errors import CommandRefused
from midstride.foreign.mode_parameters import SET_TIMEOUT, NotAnswered, on_entry, set_parameters
from midstride.foreign.services import NoAnswer, ParameterAccess
from midstride.model.component import ComponentSpec
from midstride.model.diagnostics import suggestion
from midstride.wire import commands, replies

# How long the node may take to say the values of its parameters (s).
READ_TIMEOUT: Final = 1.0
# How often it looks whether the node offers the services for that (s).
LOOK: Final = 0.02
# How long one that has not said whether it has set its parameters may take to have them back (s).
TAKE_BACK_TIMEOUT: Final = 0.5
# Parameters that ROS 2 itself declares, and that cannot be set.
_OF_ROS: Final = ("qos_overrides.", "start_type_description_service")


class ParameterRecord(Protocol):
    """The part of a :class:`midstride.foreign.record.ForeignRecord` that concerns the parameters since the start."""

    @property
    def instance(self) -> str: ...
    @property
    def node(self) -> str: ...
    @property
    def modes(self) -> Mapping[str, str]: ...
    @property
    def stated(self) -> dict[str, Any]: ...
    @property
    def taken_over(self) -> dict[str, Any]: ...
    @property
    def started_with(self) -> dict[str, Any] | None: ...
    @property
    def requested(self) -> list[str]: ...


class ParameterHolder(Protocol):
    """A node whose parameters are read and set. ``declared``: of those set while it ran, what they were before."""

    component: ComponentSpec
    parameters: dict[str, Any]
    declared: dict[str, Any]
    unread_parameters: bool

    @property
    def record(self) -> ParameterRecord: ...

    def change_record(self, **changes: Any) -> None:
        """Change these fields of the record."""

    def note_settings(self) -> None:
        """Note what requests have asked the node to set."""


class ForeignParameters:
    """The ROS parameters of ``node``, which are in its state as of the last :meth:`read`."""

    def __init__(self, node: ParameterHolder, services: ParameterAccess) -> None:
        self._node = node
        self._services = services
        self._offered_by: float | None = None  # until when it may begin to offer the services, by the loop's clock

    async def read(self, *, wait: bool = False) -> None:
        """Have the state show them, or that the node does not answer.

        One without the services is waited for once, READ_TIMEOUT from the first time, or so long from now where it is
        to ``wait``: it may be about to offer them, or discovery late.
        """
        node, clock = self._node, asyncio.get_running_loop().time
        deadline = clock() + READ_TIMEOUT
        self._offered_by = self._offered_by or deadline
        offered_by = deadline if wait else self._offered_by
        while not self._services.offers_parameters():
            if clock() >= offered_by:
                node.unread_parameters = True
                return
            await asyncio.sleep(LOOK)
        try:
            found = await self._services.parameters(deadline - clock())
        except NoAnswer:
            node.unread_parameters = True
            return
        node.unread_parameters = False
        values = {name: value for name, value in found.items() if not name.startswith(_OF_ROS)}
        record = node.record
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
        of_modes = {name for functionality in self._node.component for name in functionality.mode_parameters()}
        self._node.note_settings()
        self._node.parameters = values
        self._node.declared = {
            name: started_with.get(name, value)
            for name, value in values.items()
            if name not in of_modes and (name not in started_with or started_with[name] != value)
        }

    async def set(self, command: commands.SetParametersCommand) -> replies.PreviousParameters:
        """All of them or none; those that have their value already are not set. Raises CommandRefused.

        Values of the specification that a mode states otherwise are set when that mode is left.
        """
        node, names = self._node, command.parameters.keys()
        await self.read(wait=True)
        if node.unread_parameters:
            words = f"has not said its parameters within {READ_TIMEOUT:g} s"
            if not self._services.offers_parameters():
                words = f"offers no services for its parameters that the graph has shown within {READ_TIMEOUT:g} s"
            words = f"its node {node.record.node} {words}"
            raise CommandRefused(f"{node.record.instance} has not set {', '.join(names)}: {words}; nothing was set")
        before, declared = dict(node.parameters), dict(node.declared)
        held = self._stated_by_modes() if command.declared is None else frozenset()
        changed = {
            name: value for name, value in command.parameters.items() if before.get(name) != value and name not in held
        }
        try:
            await self.apply(changed, command.timeout)
        except NotAnswered as error:
            raise CommandRefused(f"{error}; {await self._take_back(changed)}") from None
        except CommandRefused as error:
            hints = [f"it has no {name}; {suggestion(name, before)}" for name in changed if name not in before]
            raise CommandRefused("; ".join([str(error), *hints])) from None
        self._note_set(command)
        await self.read()
        return replies.PreviousParameters(
            before={name: before[name] for name in names if name in before},
            declared={name: declared[name] for name in names if name in declared},
        )

    def _stated_by_modes(self) -> frozenset[str]:
        """The parameters of which the current modes state the values."""
        component, modes = self._node.component, self._node.record.modes
        current = (each.modes[each.mode_index(modes[each.name])] for each in component)
        return frozenset(name for mode in current for name in mode.parameters)

    async def _take_back(self, values: Mapping[str, Any]) -> str:
        """Set what was there before ``values``, which may have been set or may be set yet; say what comes of it."""
        before = {name: value for name, value in self._node.parameters.items() if name in values}
        try:
            await self.apply(before, TAKE_BACK_TIMEOUT)
        except CommandRefused:
            return "whether it has them now is not known: `midstride param list` says so once it answers"
        return "it has the values before"

    def _note_set(self, command: commands.SetParametersCommand) -> None:
        """Note in the record what the node has from now on, and whose values these are."""
        record, names = self._node.record, command.parameters.keys()
        stated = command.parameters if command.declared is None else command.declared
        requested = {*record.requested} - names
        own = stated if command.declared is None else {name: stated[name] for name in stated if name in record.stated}
        if command.declared is not None:
            requested |= names - {*command.unknown_origin}
        self._node.change_record(
            started_with={**(record.started_with or {}), **stated},
            stated={**record.stated, **own},
            requested=sorted(requested),
        )

    async def enter_modes(self, modes: Mapping[str, str]) -> None:
        """Set what these modes (by functionality) state. Raises CommandRefused with the node's reason."""
        await self.apply(on_entry(self._node.component, modes, self._node.record.stated))

    async def apply(self, values: Mapping[str, Any], timeout: float = SET_TIMEOUT) -> None:
        """Set all of these in ``timeout`` (s), or none. Raises CommandRefused with the reason, or NotAnswered."""
        node = self._node
        await set_parameters(self._services, node.record.instance, node.component, values, node.parameters, timeout)
