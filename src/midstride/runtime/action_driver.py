"""What each action of the model does on live components.

An action is done when every component concerned has acknowledged it. One that fails leaves nothing half done, as far
as the components can be reached.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from midstride.errors import CallTimeout, MidstrideError, Unreachable
from midstride.model.action import Action, Attach, Create, Degrade, Detach, Handover, Remove, SetParameters, Upgrade
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.component_client import ComponentClient
from midstride.runtime.handover import (
    ATTACH_TIMEOUT,
    DETACH_TIMEOUT,
    LingeringReaders,
    hand_over,
    no_lingering_readers,
)
from midstride.runtime.launcher import Launcher
from midstride.wire.commands import (
    AttachCommand,
    Command,
    DetachCommand,
    ExportStateCommand,
    ImportStateCommand,
    ModesCommand,
    SetParametersCommand,
)

R = TypeVar("R")

# How long a call of user code may take to return before a mode change is given up (s).
DRAIN_TIMEOUT: Final = 5.0

Tell = Callable[[str, str, dict[str, Any]], object]


@dataclass(slots=True)
class ActionDriver:
    """Performs actions on the components of one change. ``tell`` is told what is worth knowing.

    While ``taking_back``, what was removed has its own state again, and a state that cannot be had stops nothing.
    ``last_numbers`` holds the number of the last message of each output that was taken off its topic.
    """

    client: ComponentClient
    launcher: Launcher
    tell: Tell
    has_exited: Callable[[str], bool] = lambda _: False
    lingering_readers: LingeringReaders = no_lingering_readers
    before_handover: Callable[[Configuration, Handover], Awaitable[None]] | None = None
    drain_timeout: float = DRAIN_TIMEOUT
    rolling_back: bool = False
    last_numbers: dict[PortRef, int | None] = field(default_factory=dict)
    _exported: dict[str, bytes] = field(default_factory=dict)  # by role: a change removes of each at most one instance

    async def perform(self, action: Action, configuration: Configuration, because: str) -> None:
        """Carry out ``action``, whose precondition holds in ``configuration``. Raises MidstrideError.

        ``because`` is the reason that components give for the modes they are in.
        """
        if self._is_void(action, configuration):
            return
        match action:
            case Create():
                await self._create(action)
            case Remove():
                await self._remove(action, configuration)
            case Attach():
                await self._attach(action, configuration)
            case Detach():
                await self._detach(action, configuration)
            case Degrade() | Upgrade():
                await self._set_modes(action, configuration, because)
            case Handover():
                await self._hand_over(action, configuration)
            case SetParameters():
                await self.client.change(action.instance, SetParametersCommand(parameters=dict(action.parameters)))

    def _is_void(self, action: Action, configuration: Configuration) -> bool:
        """Whether nothing is to be done on the components: the action only takes something from a process that has
        ended, or the port has its endpoint on that topic, and keeps it, by another contract of the topic."""
        match action:
            case Attach(port, connector):
                return _has_endpoint(configuration, port, connector)
            case Detach(port, connector):
                return self._is_gone(port.instance) or _has_endpoint(configuration, port, connector)
            case Remove(component):
                return self.has_exited(component)
            case _:
                return False

    def _is_gone(self, instance: str) -> bool:
        """Whether its process has exited, or is about to: the end of its connection is known first."""
        return self.has_exited(instance) or self.client.is_lost(instance)

    async def _create(self, action: Create) -> None:
        await self.launcher.registered(action.instance)
        state = self._exported.get(action.instance.role)
        if state is not None:
            await self._give(action.instance.name, state)

    async def _remove(self, action: Remove, configuration: Configuration) -> None:
        instance = configuration.instances[action.instance]
        if not self.rolling_back:  # else it is what this very change has created, and what comes back has its own
            try:
                exported = await self.client.read(action.instance, ExportStateCommand())
                if exported.state is not None:
                    self._exported[instance.role] = exported.state
            except (CallTimeout, Unreachable) as error:  # what no longer answers must still be removable
                self.tell("note", f"the state of {action.instance} is lost: {error}", {})
        if instance.component.run is None:
            await self.launcher.release(action.instance)
            self.tell("note", f"{action.instance} was started elsewhere: it is released, and left running", {})
        else:
            await self.launcher.end(action.instance)

    async def _give(self, instance: str, state: bytes) -> None:
        try:
            await self.client.change(instance, ImportStateCommand(state=state))
        except MidstrideError as error:
            if not self.rolling_back:
                raise
            self.tell("note", f"{instance} did not restore its state: {error}", {})

    async def _attach(self, action: Attach, configuration: Configuration) -> None:
        port, output = action.port, configuration.is_output(action.port)
        others = configuration.subscribers_on if output else configuration.publishers_on
        topic = configuration.context.connectors[action.connector].topic
        attach = AttachCommand(port=port.port, topic=topic, peers=len(others(action.connector)), timeout=ATTACH_TIMEOUT)
        detach = DetachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT)
        await self._or_undone(self.client.change(port.instance, attach), port.instance, detach)

    async def _detach(self, action: Detach, configuration: Configuration) -> None:
        port, topic = action.port, configuration.context.connectors[action.connector].topic
        detach = DetachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT)
        attach = AttachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT)
        reply = await self._or_undone(self.client.change(port.instance, detach), port.instance, attach)
        if reply.last:
            self.last_numbers[port] = reply.last
        if reply.acknowledged is None and configuration.is_output(port):
            self.tell("note", f"{port}: unknown whether its last messages on {topic} arrived", {})

    async def _set_modes(self, action: Degrade | Upgrade, configuration: Configuration, because: str) -> None:
        """The functionalities of each instance at once, the instances one after the other."""
        changed: list[tuple[str, ModesCommand]] = []
        try:
            for instance, modes in by_instance(action.modes).items():
                if isinstance(action, Degrade) and self._is_gone(instance):
                    continue
                before = {ref: configuration.modes[ref] for ref in modes}
                changed.append((instance, self._modes_command(configuration, before, "roll-back")))
                await self.client.change(instance, self._modes_command(configuration, modes, because))
        except Exception:
            for instance, undo in reversed(changed):
                await self.client.undo(instance, undo)
            raise

    async def lower(
        self, instance: str, modes: Mapping[FunctionalityRef, int], configuration: Configuration, because: str
    ) -> None:
        """Degrade functionalities of ``instance`` that have lost what they assume. Raises MidstrideError.

        Nothing is undone then: if only the reply was lost, undoing would raise them without their inputs.
        """
        if not self._is_gone(instance):
            await self.client.change(instance, self._modes_command(configuration, modes, because))

    def _modes_command(
        self, configuration: Configuration, modes: Mapping[FunctionalityRef, int], because: str
    ) -> ModesCommand:
        names = {ref.functionality: configuration.functionality(ref).modes[index].name for ref, index in modes.items()}
        return ModesCommand(modes=names, because=because, timeout=self.drain_timeout)

    async def _hand_over(self, action: Handover, configuration: Configuration) -> None:
        for old, new in sorted({(swap.old.instance, swap.new.instance) for swap in action.swaps}):
            same_role = configuration.instances[old].role == configuration.instances[new].role
            if old != new and same_role:  # else nothing is replaced
                await self._carry_state(old, new)
        if self.before_handover is not None:
            await self.before_handover(configuration, action)
        handed = await hand_over(self.client, self.lingering_readers, configuration, action)
        self.last_numbers.update(handed.last)
        for warning in handed.warnings:
            self.tell("note", warning, {})

    async def _carry_state(self, old: str, new: str) -> None:
        try:
            exported = await self.client.read(old, ExportStateCommand())
        except MidstrideError as error:
            if not self.rolling_back:
                raise
            self.tell("note", f"{new} keeps its own state: {error}", {})
            return
        if exported.state is not None:
            await self._give(new, exported.state)

    async def _or_undone(self, attempt: Awaitable[R], instance: str, undo: Command[Any]) -> R:
        """``attempt``; where it fails, ``undo`` takes back what it may have left."""
        try:
            return await attempt
        except Exception:
            await self.client.undo(instance, undo)
            raise


def by_instance(modes: Mapping[FunctionalityRef, int]) -> dict[str, dict[FunctionalityRef, int]]:
    """The modes of each instance, the instances in order of their names."""
    found: dict[str, dict[FunctionalityRef, int]] = {}
    for ref, index in sorted(modes.items()):
        found.setdefault(ref.instance, {})[ref] = index
    return found


def _has_endpoint(configuration: Configuration, port: PortRef, connector: str) -> bool:
    """Whether ``port`` is attached to another connector of the same topic: to its contract before or after a
    change. The components know the topic alone."""
    connectors = configuration.context.connectors
    return any(
        other != connector and connectors[other].topic == connectors[connector].topic
        for other in configuration.attached_to(port)
    )
