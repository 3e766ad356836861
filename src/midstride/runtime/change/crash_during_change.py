"""Degrades what a crash during a change has left without support at once, not only when the change has ended.

The model follows at the end of the change, so that its steps and their roll-back find what they were planned for; until
then, the functionalities concerned are in lower modes than in the model. The instances that the change creates, removes
or swaps are the change's: it completes or is rolled back, and what is then missing is reconciled
(docs/protocols/faults.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from midstride.model.action import Action, Create, Handover, Remove
from midstride.model.component import FunctionalityRef
from midstride.runtime.change.mode_changes import lower_modes
from midstride.runtime.change.reconciler import Reconciler, respond
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.change_observer import ChangeObserver


@dataclass(slots=True)
class CrashResponse(ChangeObserver):
    """The response to crashes during ``change``."""

    change: RunningChange
    reconciler: Reconciler
    _lowered: dict[FunctionalityRef, int] = field(default_factory=dict)
    _closed: bool = False

    async def close(self) -> None:
        """The steps have ended, and the reconciler takes over."""
        self._closed = True
        async with self.change.commanding:
            pass  # what is being degraded is

    async def crashed(self) -> None:
        """A component has crashed: degrade what relies on it, as soon as no step commands the same components."""
        async with self.change.commanding:
            if not self._closed:
                await self._lower()

    async def performed(self, action: Action) -> None:
        """An action of the change has been performed, or undone: it may have raised what a crash had lowered."""
        if not self.reconciler.system.life.exits:
            return
        for ref in getattr(action, "modes", ()):
            self._lowered.pop(ref, None)
        await self.crashed()

    async def _lower(self) -> None:
        system, reconciler = self.reconciler.system, self.reconciler
        configuration = system.configuration
        own = {
            name
            for action in self.change.actions
            if isinstance(action, (Create, Remove, Handover))
            for name in action.instances()
        }
        exits = system.life.exits
        gone = [name for name in exits if name in configuration.instances and name not in own]
        _, needed = respond(configuration, gone, {})
        wanted = {ref: index for ref, index in needed.items() if ref.instance not in own}
        live = (ref for ref in self._lowered if ref not in wanted and ref in configuration.modes)
        # A step has given these other support.
        changes = {ref: configuration.modes[ref] for ref in live}
        changes |= {ref: index for ref, index in wanted.items() if self._lowered.get(ref) != index}
        because = "; ".join(exits[name].words for name in gone)
        await lower_modes(changes, because, reconciler.client, system, reconciler.events)
        self._lowered = wanted
        reconciler.pending |= dict.fromkeys(wanted)
