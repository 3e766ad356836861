"""Performs one action of a change on live components, and updates the model once they have acknowledged it."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass

from midstride.model.action import Action, Create, Handover, Remove, SetParameters
from midstride.model.configuration import Configuration
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.handover.cut_turns import CutTurn
from midstride.runtime.records.state_store import StateStore


@dataclass(frozen=True, slots=True)
class ActionPerformer:
    """Performs the actions of the change of ``driver``, forwards and back."""

    driver: ActionDriver
    store: StateStore

    async def perform(self, action: Action, turn: CutTurn | None = None) -> Configuration:
        """Check the precondition of one action, carry it out, and update the model. Raises MidstrideError.

        Returns the configuration that it was applied to. ``turn``: of a hand-over beside others.
        """
        async with self.lock_for(action) or contextlib.nullcontext():
            return await self.perform_locked(action, turn)

    def lock_for(self, action: Action) -> asyncio.Lock | None:
        """The lock that is held during ``action``; None if the response to a crash leaves its instances alone."""
        return None if isinstance(action, Create | Handover | Remove) else self.driver.change.commanding

    async def perform_locked(self, action: Action, turn: CutTurn | None = None) -> Configuration:
        """Perform like :meth:`perform`, while the caller holds the lock for ``action``."""
        before = self.driver.system.configuration
        action.apply(before)
        await self.driver.perform(action, f"the plan asked for it: {action.describe(before)}", turn)
        before = self.driver.system.configuration  # steps beside it may have been done meanwhile
        after = action.effect(before)
        self.driver.system.moved(after)
        self.driver.change.moved(after, action.instances())
        match action:
            case Create(instance) if instance.component.once:
                self.store.write_instance(instance, None, done=True)
            case Remove(instance):
                self.store.remove_instance(instance)
            case SetParameters(instance):
                self.store.write_instance(after.instances[instance], self.driver.system.life[instance].handle)
        return before
