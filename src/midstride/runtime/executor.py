"""Carrying a plan out on live components, step by step, and taking it back if a step does not hold.

A step is done when every component concerned has acknowledged it; then, and only then, the model's
configuration moves on. A step that fails leaves nothing half done, and the steps before it are
undone in reverse order (semantics.md F6).
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from immutables import Map
from msgspec import UNSET

from midstride.errors import MidstrideError, StepFailed
from midstride.model.action import Action, Create, Degrade, Remove, SetParameters
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration, Instance
from midstride.plan.forms import AnyStep
from midstride.runtime.action_driver import ActionDriver, by_instance
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.state_store import StateStore

log = logging.getLogger(__name__)

Done = list[tuple[Action, Configuration]]


@dataclass(slots=True)
class Executor:
    """Carries out actions on the running system. ``on_moved`` is called with each configuration that a step leads
    to, and with the instances that the step has changed.

    ``after_step`` looks at each step of a plan once it is done: the step has failed where it raises.
    """

    driver: ActionDriver
    system: RunningSystem
    store: StateStore
    on_started: Callable[[Instance], None] = lambda _: None
    on_moved: Callable[[Configuration, Collection[str]], None] = lambda *_: None
    after_step: Callable[[Configuration], Awaitable[None]] | None = None

    async def run(self, actions: Sequence[Action], forms: Sequence[AnyStep] = ()) -> None:
        """Carry out ``actions`` in order.

        Raises StepFailed once everything has been taken back, or could not be: its ``outcome`` says which. Where it
        is cancelled, everything is taken back as well.
        """
        done: Done = []
        for index, action in enumerate(actions):
            step = forms[index] if index < len(forms) else UNSET
            position = {"index": index, "of": len(actions), "step": step}
            what = action.describe(self.system.configuration)
            self._tell("step", f"{index + 1}/{len(actions)} {what}", position)
            try:
                if isinstance(action, Create):
                    await self._start_ahead(actions[index:])
                await self._step(action, done)
                if self.after_step is not None:
                    await self.after_step(self.system.configuration)
            except (Exception, asyncio.CancelledError) as error:
                why = _words(error)
                self._tell("step_failed", f"{what} failed: {why}", position)
                await self._abandon_started(actions[index:])
                problem = await self._roll_back(done)
                if isinstance(error, asyncio.CancelledError):
                    raise
                outcome = "rolled_back" if problem is None else "failed"
                because = f"{what}: {why}" + ("" if problem is None else f"; and the roll-back failed: {problem}")
                raise StepFailed(because, outcome) from error
            self._tell("step_done", f"{index + 1}/{len(actions)} done", position)

    async def _step(self, action: Action, done: Done) -> None:
        """Perform ``action`` and note that it is done.

        No step is left half way: whoever is cancelled meanwhile waits for its end, which comes in bounded time. Only
        a creation is broken off, since that leaves nothing.
        """
        before = self.system.configuration
        performing = asyncio.ensure_future(self.perform(action))
        try:
            await asyncio.shield(performing)
        except asyncio.CancelledError:
            if isinstance(action, Create):
                performing.cancel()
            await asyncio.wait({performing})
            if not performing.cancelled() and performing.exception() is None:
                done.append((action, before))
            raise
        done.append((action, before))

    async def perform(self, action: Action) -> None:
        """Check one action against the model, carry it out, and move the model on. Raises MidstrideError."""
        before = self.system.configuration
        after = action.apply(before)
        await self.driver.perform(action, before, f"the plan asked for it: {action.describe(before)}")
        self._moved(after, action.instances())
        match action:
            case Remove(instance):
                self.store.remove_instance(instance)
            case SetParameters(instance):
                self.store.write_instance(after.instances[instance], self.driver.launcher.handles.get(instance))

    def _moved(self, configuration: Configuration, instances: Collection[str]) -> None:
        self.system.moved(configuration)
        self.on_moved(configuration, instances)

    async def lower(self, modes: Mapping[FunctionalityRef, int], because: str) -> set[FunctionalityRef]:
        """Lower functionalities that have lost what they assume, whoever else does not answer; those that were not.

        There is no order to keep and no precondition to check: what they assume is gone already.
        """
        groups = by_instance(modes)
        results = await asyncio.gather(*(self._lower(name, group, because) for name, group in groups.items()))
        failed = {ref for group, lowered in zip(groups.values(), results, strict=True) if not lowered for ref in group}
        if len(failed) < len(modes):
            reached = {ref: index for ref, index in modes.items() if ref not in failed}
            self._moved(self.system.configuration.with_modes(reached), {ref.instance for ref in reached})
        return failed

    async def _lower(self, instance: str, modes: Mapping[FunctionalityRef, int], because: str) -> bool:
        words = Degrade(Map(modes)).describe(self.system.configuration)
        try:
            await self.driver.lower(instance, modes, self.system.configuration, because)
        except MidstrideError as error:
            self._tell("note", f"{words} failed: {error}", {})
            return False
        self._tell("degraded", words, {})
        return True

    async def _roll_back(self, done: Done) -> str | None:
        """Undo what was done, last first. None, or why it could not be undone."""
        if not done:
            return None
        self._tell("rollback", f"rolling back {len(done)} step{'s' if len(done) > 1 else ''}", {"of": len(done)})
        self.driver.rolling_back = True
        for action, before in reversed(done):
            for undoing in action.undo(before):
                what = undoing.describe(self.system.configuration)
                try:
                    await self.perform(undoing)
                except Exception as error:
                    problem = f"{what}: {_words(error)}"
                    self._tell("rollback_failed", f"the roll-back is incomplete: {problem}", {})
                    return problem
        self._tell("rolled_back", "everything is as it was before", {})
        return None

    async def _start_ahead(self, actions: Iterable[Action]) -> None:
        """Start the processes of all creations in a row at once: they load while the first is waited for."""
        for action in actions:
            if not isinstance(action, Create):
                break
            if await self.driver.launcher.start(action.instance):
                self.on_started(action.instance)
                handle = self.driver.launcher.handles.get(action.instance.name)
                self.store.write_instance(action.instance, handle)

    async def _abandon_started(self, actions: Iterable[Action]) -> None:
        for action in actions:
            if isinstance(action, Create) and action.instance.name not in self.system.configuration.instances:
                await self.driver.launcher.abandon(action.instance.name)
                if action.instance.name not in self.driver.launcher.handles:
                    self.store.remove_instance(action.instance.name)

    def _tell(self, kind: str, words: str, details: dict[str, Any]) -> None:
        self.driver.tell(kind, words, details)


def _words(error: BaseException) -> str:
    """An exception in words; one that nobody foresaw goes to the log with its traceback."""
    if isinstance(error, MidstrideError):
        return str(error)
    if isinstance(error, asyncio.CancelledError):
        return "the manager is shutting down"
    log.error("a step failed with an unexpected error", exc_info=error)
    return f"internal error: {error!r}"
