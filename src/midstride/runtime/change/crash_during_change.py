"""Degrades what a crash during a change has left without support at once, not only when the change has ended.

The model follows at the end of the change, so that its steps and their roll-back find what they were planned for; until
then, the functionalities concerned are in lower modes than in the model. The instances that the change creates, removes
or swaps are the change's: it completes or is rolled back, and what is then missing is reconciled
(docs/semantics.md section 7).
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass, field

from immutables import Map

from midstride.errors import MidstrideError
from midstride.model.action import Action, Create, Degrade, Handover, Remove
from midstride.model.component import FunctionalityRef
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.change.mode_changes import by_instance
from midstride.runtime.change.reconciler import Reconciler, respond


@dataclass(slots=True)
class CrashResponse:
    """The response to crashes during one change, for which ``driver`` performs ``actions``.

    ``commanding`` is held while it sends commands, and by the executor of the change while that does.
    """

    driver: ActionDriver
    reconciler: Reconciler
    actions: Iterable[Action]
    commanding: asyncio.Lock = field(default_factory=asyncio.Lock)
    _lowered: dict[FunctionalityRef, int] = field(default_factory=dict)
    _closed: bool = False

    async def close(self) -> None:
        """The steps have ended, and the reconciler takes over."""
        self._closed = True
        async with self.commanding:
            pass  # what is being degraded is

    async def crashed(self) -> None:
        """A component has crashed: degrade what relies on it, as soon as no step commands the same components."""
        async with self.commanding:
            if not self._closed:
                await self._lower()

    async def performed(self, action: Action) -> None:
        """An action of the change has been performed, or undone: it may have raised what a crash had lowered."""
        if not self.driver.system.crashed:
            return
        for ref in getattr(action, "modes", ()):
            self._lowered.pop(ref, None)
        await self.crashed()

    async def _lower(self) -> None:
        system, driver = self.driver.system, self.driver
        configuration = system.configuration
        own = {
            name
            for action in self.actions
            if isinstance(action, (Create, Remove, Handover))
            for name in action.instances()
        }
        gone = [name for name in system.crashed if name in configuration.instances and name not in own]
        _, needed = respond(configuration, gone, {})
        wanted = {ref: index for ref, index in needed.items() if ref.instance not in own}
        live = (ref for ref in self._lowered if ref not in wanted and ref in configuration.modes)
        # A step has given these other support.
        changes = {ref: configuration.modes[ref] for ref in live}
        changes |= {ref: index for ref, index in wanted.items() if self._lowered.get(ref) != index}
        for name, modes in by_instance(changes).items():
            words = Degrade(Map(modes)).describe(configuration)
            try:
                await driver.modes.lower(name, modes, "; ".join(f"{each} exited unexpectedly" for each in gone))
                driver.events.add("degraded", words)
            except MidstrideError as error:
                driver.events.add("note", f"{words} failed: {error}")
        self._lowered = wanted
        self.reconciler.pending |= dict.fromkeys(wanted)
