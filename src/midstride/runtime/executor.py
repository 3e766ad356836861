"""Carries out a plan on live components, step by step, and rolls it back if a step fails.

The model's configuration changes only once every component concerned has acknowledged a step. If a step fails, its
partial effects are undone, then the steps before it in reverse order (docs/semantics.md F6).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from immutables import Map
from msgspec import UNSET

from midstride.errors import BackendError, MidstrideError, StepFailed, Superseded
from midstride.model.action import Action, Create, Degrade, Handover, Remove, SetParameters
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.wording import counted
from midstride.plan.step_forms import AnyStep
from midstride.runtime.action_driver import ActionDriver, by_instance
from midstride.runtime.backend import Exited
from midstride.runtime.journal import JournalEntry
from midstride.runtime.pacing import room_for_a_start
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.state_store import StateStore

log = logging.getLogger(__name__)

Done = list[tuple[Action, Configuration]]

# After how long a process that could not be started ahead of its step is tried again (s): what was in its way, such as
# an earlier node of its name, may have gone.
START_AGAIN: Final = 1.0


class _AheadFailed(Exception):
    """A process that was started ahead of its step could not start, or has exited; ``error`` says why."""

    def __init__(self, action: Create, error: MidstrideError) -> None:
        super().__init__(str(error))
        self.action, self.error = action, error


@dataclass(slots=True)
class Executor:
    """Carries out actions on the running system.

    ``on_moved`` is called with the configuration after each step and the instances that the step changed.
    ``after_step`` checks the configuration after each step of a plan: if it raises, the step has failed. ``entry``
    records the steps in the journal. ``on_performed`` is called after each action of a plan and of its roll-back;
    ``commanding`` is held while an action sends commands to components that run already: a component refuses the second
    of two changes at one revision.
    """

    driver: ActionDriver
    store: StateStore
    on_moved: Callable[[Configuration, Collection[str]], None] = lambda *_: None
    after_step: Callable[[Configuration], Awaitable[None]] | None = None
    entry: JournalEntry | None = None
    on_performed: Callable[[Action], Awaitable[None]] | None = None
    commanding: asyncio.Lock = field(default_factory=asyncio.Lock)
    _one_start: asyncio.Lock = field(default_factory=asyncio.Lock)
    _ahead: asyncio.Task[None] | None = None  # starts the processes of the next creations

    @property
    def system(self) -> RunningSystem:
        return self.driver.system

    async def run(self, actions: Sequence[Action], forms: Sequence[AnyStep] = ()) -> None:
        """Carry out ``actions`` in order.

        Raises StepFailed after the roll-back; its ``outcome`` says whether that succeeded. If cancelled, it rolls back
        as well.
        """
        done: Done = []
        self.driver.leaving = {action.instance for action in actions if isinstance(action, Remove)}
        for index, action in enumerate(actions):
            position = _position(actions, index, forms)
            what = action.describe(self.system.configuration)
            self.driver.events.add("step", f"{index + 1}/{len(actions)} {what}", **position)
            try:
                if self.entry is not None:
                    await self.entry.step(what)
                if isinstance(action, Create):
                    await self._start(action)
                    if index == 0 or not isinstance(actions[index - 1], Create):
                        await self._stop_starting()
                        self._ahead = asyncio.ensure_future(self._start_ahead(actions[index + 1 :]))
                await self._timed_step(action, done, actions)
                await self.driver.watch(action)
                if index == len(actions) - 1:
                    await self.driver.settle()
                if self.after_step is not None:
                    await self.after_step(self.system.configuration)
            except (Exception, asyncio.CancelledError) as raised:
                error: BaseException = raised
                if isinstance(raised, _AheadFailed):  # not this step has failed, but a later one
                    error, what = raised.error, raised.action.describe()
                    position = _position(actions, actions.index(raised.action), forms)
                why = _words(error)
                self.driver.events.add("step_failed", f"{what} failed: {why}", **position)
                if isinstance(error, Superseded) or not (self.entry is None or await self.entry.failed()):
                    # What runs is the other manager's.
                    await self._stop_starting()
                    words = f"{what}: {why}; nothing is rolled back, since another manager has taken over"
                    raise StepFailed(words, "failed") from error
                problems = [*await self._abandon_started(actions[index:]), *await self._roll_back(done)]
                if isinstance(error, asyncio.CancelledError):
                    raise
                if not problems:
                    raise StepFailed(f"{what}: {why}", "rolled_back") from error
                raise StepFailed(f"{what}: {why}; and the roll-back failed: {'; '.join(problems)}", "failed") from error
            self.driver.events.add("step_done", f"{index + 1}/{len(actions)} done", **position)
        await self._stop_starting()

    async def _timed_step(self, action: Action, done: Done, actions: Sequence[Action]) -> None:
        clock, key = self.driver.backend.clock, _estimates(action, self.system.configuration, actions)
        begun = clock.steady()
        await self._step(action, done)
        if self.entry is not None:
            self.entry.took(clock.steady() - begun, key)

    async def _step(self, action: Action, done: Done) -> None:
        """Perform ``action`` and append it to ``done``.

        If cancelled, it first waits for the action to end, in bounded time, so that no step is left incomplete. Only a
        creation is interrupted: it cleans up after itself. So it is as soon as a process started ahead has failed: this
        one may be waiting for that one, and would be blamed.
        """
        before = self.system.configuration
        performing = asyncio.ensure_future(self.perform(action))
        try:
            if isinstance(action, Create) and self._ahead is not None:
                await asyncio.wait({performing, self._ahead}, return_when=asyncio.FIRST_COMPLETED)
                if not performing.done():
                    self._ahead.result()
            await asyncio.shield(performing)
        except (asyncio.CancelledError, _AheadFailed):
            if isinstance(action, Create):
                performing.cancel()
            await asyncio.wait({performing})
            if not performing.cancelled() and performing.exception() is None:
                done.append((action, before))
            raise
        done.append((action, before))
        if self.on_performed is not None:
            await self.on_performed(action)

    async def perform(self, action: Action) -> None:
        """Check the precondition of one action, carry it out, and update the model. Raises MidstrideError."""
        before = self.system.configuration
        after = action.apply(before)
        because = f"the plan asked for it: {action.describe(before)}"
        async with contextlib.nullcontext() if isinstance(action, Create) else self.commanding:
            await self.driver.perform(action, because)
        self._moved(after, action.instances())
        match action:
            case Remove(instance):
                self.store.remove_instance(instance)
            case SetParameters(instance):
                self.store.write_instance(after.instances[instance], self.driver.launcher.handles.get(instance))

    def _moved(self, configuration: Configuration, instances: Collection[str]) -> None:
        self.system.moved(configuration)
        self.on_moved(configuration, instances)

    async def lower(
        self, modes: Mapping[FunctionalityRef, int], because: str
    ) -> dict[FunctionalityRef, MidstrideError]:
        """Degrade functionalities whose assumptions no longer hold; returns why each of the others could not be.

        Instances are independent of each other here. No order and no precondition applies: the assumptions are already
        violated.
        """
        failed: dict[FunctionalityRef, MidstrideError] = {}

        async def lower_instance(name: str, group: Mapping[FunctionalityRef, int]) -> None:
            words = Degrade(Map(group)).describe(self.system.configuration)
            try:
                await self.driver.lower(name, group, because)
                self.driver.events.add("degraded", words)
            except MidstrideError as error:
                self.driver.events.add("note", f"{words} failed: {error}")
                failed.update(dict.fromkeys(group, error))

        await asyncio.gather(*(lower_instance(name, group) for name, group in by_instance(modes).items()))
        if reached := {ref: index for ref, index in modes.items() if ref not in failed}:
            self._moved(self.system.configuration.with_modes(reached), {ref.instance for ref in reached})
        return failed

    async def _roll_back(self, done: Done) -> list[str]:
        """Undo the actions in ``done``, last first. Returns what failed; the other actions are undone.

        An instance that the change itself created is removed in any case: if it does not answer, it is killed.
        """
        if not done:
            return list(self.driver.fences.problems())
        self.driver.events.add("rollback", f"rolling back {counted(len(done), 'step')}", of=len(done))
        self.driver.rolling_back = True
        created = {action.instance.name for action, _ in done if isinstance(action, Create)}
        await self._kill(name for name in sorted(created) if self.driver.client.responsive(name) is None)
        problems = list(self.driver.fences.problems())
        kept = self._taken_over(done)
        for action, before in reversed(done):
            if kept & set(action.instances()):
                continue
            for undoing in action.undo(before):
                if (problem := await self._undo(undoing, created)) is not None:
                    problems.append(problem)
                    self.driver.events.add("rollback_failed", f"the roll-back is incomplete: {problem}")
        if not problems:
            self.driver.events.add("rolled_back", "every step has been undone")
        return problems

    def _taken_over(self, done: Done) -> set[str]:
        """The fenced instances and those that have taken over from them: a topic does not go back to one that hangs."""
        fenced = self.driver.fences.fenced
        swaps = [swap for action, _ in done if isinstance(action, Handover) for swap in action.swaps]
        return {*fenced, *(swap.new.instance for swap in swaps if swap.old.instance in fenced)}

    async def _undo(self, undoing: Action, created: Collection[str]) -> str | None:
        """Perform ``undoing``; if that fails, again without the instances in ``created``. Returns why it failed."""
        what = undoing.describe(self.system.configuration)
        while True:
            try:
                if isinstance(undoing, Create):
                    await self._start(undoing)  # the next manager must find what was removed and is there again
                await self.perform(undoing)
                if self.on_performed is not None:
                    await self.on_performed(undoing)
                return None
            except Exception as error:
                problem = f"{what}: {_words(error)}"
            if not await self._kill(name for name in undoing.instances() if name in created):
                return "; ".join([problem, *await self._abandon_started([undoing])])

    async def _kill(self, instances: Iterable[str]) -> bool:
        """Kill the processes of ``instances``, which then count as crashed; whether there was one."""
        killed = False
        for name in instances:
            if name in self.system.crashed or name not in self.driver.launcher.handles:
                continue
            try:
                await self.driver.launcher.end(name, grace=0.0)
            except BackendError as error:
                self.driver.events.add("note", f"{name} could not be killed: {error}")
                continue
            self.system.crashed[name] = Exited(name, None)
            self.driver.events.add("note", f"{name} was created by this change and does not answer: it was killed")
            killed = True
        return killed

    async def _start_ahead(self, actions: Iterable[Action]) -> None:
        """Start the processes of the next consecutive creations, so that they load in parallel, as the machine can.

        Raises _AheadFailed as soon as one of them cannot start, or has exited before it registered.
        """
        launcher, clock, started = self.driver.launcher, self.driver.backend.clock, dict[str, Create]()
        for action in actions:
            if not isinstance(action, Create):
                break
            await room_for_a_start(clock, launcher.starting)
            try:
                await self._start(action)
            except MidstrideError:
                await clock.sleep(START_AGAIN)  # meanwhile its own step may try it, and fail with the reason
                try:
                    await self._start(action)
                except MidstrideError as error:
                    raise _AheadFailed(action, error) from error
            started[action.instance.name] = action
        if (exited := await launcher.first_exit(started)) is not None:
            name, failure = exited
            raise _AheadFailed(started[name], failure)

    async def _start(self, action: Create) -> None:
        """Start the process of a creation unless it is starting already. Raises StartFailed."""
        instance = action.instance
        async with self._one_start:
            if instance.name in self.system.configuration.instances:
                return
            if await self.driver.start(instance):
                self.system.started(instance.name)
                self.store.write_instance(instance, self.driver.launcher.handles.get(instance.name))

    async def _stop_starting(self) -> None:
        if self._ahead is not None:
            async with self._one_start:  # not between the start of a process and its record
                self._ahead.cancel()
            await asyncio.gather(self._ahead, return_exceptions=True)
            self._ahead = None

    async def _abandon_started(self, actions: Iterable[Action]) -> list[str]:
        """Terminate what was started for ``actions``. Returns why each of the others could not be."""
        problems: list[str] = []
        await self._stop_starting()
        for action in actions:
            if isinstance(action, Create) and action.instance.name not in self.system.configuration.instances:
                error = await self.driver.launcher.abandon(action.instance.name)
                if error is not None:
                    problems.append(f"{action.instance.name} could not be terminated: {error}")
                else:
                    self.store.remove_instance(action.instance.name)
        return problems


def _estimates(action: Action, configuration: Configuration, actions: Sequence[Action]) -> str | None:
    """What the duration of ``action`` is an estimate of (:meth:`Change.seconds`)."""
    match action:
        case Create(instance):  # beside others, a process starts more slowly
            alone = sum(isinstance(each, Create) for each in actions) == 1
            return f"create {instance.component.name}" if alone else None
        case Remove(name):
            return f"remove {configuration.component(name).name}"
    return action.kind


def _position(actions: Sequence[Action], index: int, forms: Sequence[AnyStep]) -> dict[str, Any]:
    return {"index": index, "of": len(actions), "step": forms[index] if forms else UNSET}


def _words(error: BaseException) -> str:
    """The message of an exception; an unexpected one is logged with its traceback."""
    if isinstance(error, MidstrideError):
        return str(error)
    if isinstance(error, asyncio.CancelledError):
        return "the manager is shutting down"
    log.error("a step failed with an unexpected error", exc_info=error)
    return f"internal error: {error!r}"
