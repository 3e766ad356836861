"""Mode changes of live components: of those of several instances at once, each between two calls of its user code.

One whose user code does not return in time refuses, and the others go back to the modes that they had.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from immutables import Map

from midstride.errors import CommandRefused, MidstrideError, RevisionChanged
from midstride.model.action import Degrade, Upgrade
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.runtime.handover.fences import StepBudget
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.reports import ModeSkew
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.observed_configuration import own_degradations_in
from midstride.wire import commands, replies

# How long a call of user code may take to return before a mode change is given up (s).
DRAIN_TIMEOUT: Final = 5.0
# For how much longer than that components hold functionalities that are to change their modes at once (s): long enough
# for the commands that change them, which end that.
HELD_LONGER: Final = 2.0


@dataclass(slots=True)
class ModeChanges:
    """The changes of modes that one change makes."""

    client: ComponentClient
    system: RunningSystem
    # How far apart the functionalities of several instances changed their modes that were to do so at once.
    skews: list[ModeSkew] = field(default_factory=list)

    @property
    def configuration(self) -> Configuration:
        return self.system.configuration

    async def enter(self, action: Degrade | Upgrade, because: str, budget: StepBudget) -> None:
        """The functionalities of all instances at once; those of several are held between two calls before that."""
        groups = _by_instance(action.modes)
        if isinstance(action, Degrade):
            gone = [*filter(self.system.life.is_gone_or_fenced, groups)]
            groups = {name: modes for name, modes in groups.items() if name not in gone}
        if len(groups) > 1:
            await self._hold(groups, budget)
        found = await asyncio.gather(
            *(self._enter(name, modes, action, because, budget) for name, modes in groups.items()),
            return_exceptions=True,
        )
        if failed := [each for each in found if isinstance(each, BaseException)]:
            for (instance, modes), outcome in reversed(list(zip(groups.items(), found, strict=True))):
                if isinstance(outcome, CommandRefused):
                    continue  # it has changed nothing, and may hang
                before = {ref: self.configuration.modes[ref] for ref in modes}
                await self.client.undo(instance, _command(self.configuration, before, "roll-back", DRAIN_TIMEOUT))
            raise failed[0]
        moments = [each.at for each in found if isinstance(each, replies.PreviousModes) and each.at is not None]
        if len(moments) > 1:
            names = [str(ref) for modes in groups.values() for ref in modes]
            self.skews.append(ModeSkew(action.kind, names, round((max(moments) - min(moments)) / 1e9, 9)))

    async def _hold(self, groups: Mapping[str, Mapping[FunctionalityRef, int]], budget: StepBudget) -> None:
        """Have each instance begin no call of its functionalities until their modes change. Raises what one raises."""
        timeouts = {name: budget.timeout(name, DRAIN_TIMEOUT) for name in groups}
        seconds = max(timeouts.values()) + HELD_LONGER

        async def hold(instance: str) -> None:
            names = [ref.functionality for ref in groups[instance]]
            command = commands.HoldCommand(functionalities=names, seconds=seconds, timeout=timeouts[instance])
            await self.client.change(instance, command)

        found = await asyncio.gather(*map(hold, groups), return_exceptions=True)
        if failed := [each for each in found if each is not None]:
            end = commands.HoldCommand(functionalities=[], seconds=0.0)
            await asyncio.gather(*(self.client.undo(instance, end) for instance in groups))
            raise failed[0]

    async def _enter(
        self,
        instance: str,
        modes: Mapping[FunctionalityRef, int],
        action: Degrade | Upgrade,
        because: str,
        budget: StepBudget,
    ) -> replies.PreviousModes:
        command = _command(self.configuration, modes, because, budget.timeout(instance, DRAIN_TIMEOUT))
        try:
            return await self.client.change(instance, command)
        except CommandRefused:
            if isinstance(action, Upgrade) or budget.is_spent(instance):
                raise
            if not own_degradations_in(self.configuration, await self.client.peek(instance)):
                raise
            return await self.client.change(instance, command)  # whatever mode it has fallen to


async def lower_modes(
    modes: Mapping[FunctionalityRef, int],
    because: str,
    client: ComponentClient,
    system: RunningSystem,
    events: EventLog,
) -> dict[FunctionalityRef, MidstrideError]:
    """Degrade functionalities whose assumptions no longer hold; returns why each of the others could not be.

    Instances are independent of each other here. No order and no precondition applies: the assumptions are already
    violated. A failure is not undone: if only the reply was lost, undoing would upgrade them without their inputs.
    """
    failed: dict[FunctionalityRef, MidstrideError] = {}

    async def lower_instance(name: str, group: Mapping[FunctionalityRef, int]) -> None:
        words = Degrade(Map(group)).describe(system.configuration)
        command = _command(system.configuration, group, because, DRAIN_TIMEOUT)
        try:
            if not system.life.is_gone(name):
                try:
                    await client.change(name, command)
                except RevisionChanged:  # one that was stopped may just have carried out what it was sent before
                    await client.change(name, command)
            events.add("degraded", words)
        except MidstrideError as error:
            events.add("note", f"{words} failed: {error}")
            failed.update(dict.fromkeys(group, error))

    await asyncio.gather(*(lower_instance(name, group) for name, group in _by_instance(modes).items()))
    return failed


def _command(
    configuration: Configuration, modes: Mapping[FunctionalityRef, int], because: str, timeout: float
) -> commands.ModesCommand:
    names: dict[str, Any] = {
        ref.functionality: configuration.functionality(ref).modes[index].name for ref, index in modes.items()
    }
    # A lifecycle node may have to be activated for it.
    activation = max((configuration.component(ref.instance).activate_seconds or 0.0 for ref in modes), default=0.0)
    return commands.ModesCommand(modes=names, because=because, timeout=timeout + activation)


def _by_instance(modes: Mapping[FunctionalityRef, int]) -> dict[str, dict[FunctionalityRef, int]]:
    """The modes of each instance, the instances in order of their names."""
    found: dict[str, dict[FunctionalityRef, int]] = {}
    for ref, index in sorted(modes.items()):
        found.setdefault(ref.instance, {})[ref] = index
    return found
