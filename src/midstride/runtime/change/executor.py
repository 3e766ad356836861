"""Carries out a plan on live components, step by step, and rolls it back if a step fails.

The model's configuration changes only once every component concerned has acknowledged a step. If a step fails, its
partial effects are undone, then the steps before it in reverse order (docs/semantics.md F6).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from midstride.errors import (
    EndUnknown,
    MidstrideError,
    StepFailed,
    Superseded,
)
from midstride.model.action import Action, Create, Handover, Remove, SetParameters
from midstride.model.configuration import Configuration
from midstride.plan.change import measured_key
from midstride.plan.overlap import Overlap, one_by_one
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.cancellation import run_to_completion
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.change.action_performer import ActionPerformer
from midstride.runtime.change.change_phases import ChangeEvent
from midstride.runtime.change.early_starts import EarlyStarts, StartFailedEarly
from midstride.runtime.change.roll_back import DoneActions, RollBack
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.change.settings_watch import BrokenBySetting
from midstride.runtime.change.step_failure import failure_reason
from midstride.runtime.change.step_order import StepOrder
from midstride.runtime.handover.cut_turns import CutTurn, CutTurns, GivenUp
from midstride.runtime.records.reports import StepTime
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.running_system import RunningSystem

log = logging.getLogger(__name__)

# Where what cannot be started is left out: after how long without a registration (s) the steps go on that do not need
# a process that has not registered.
LATE: Final = 1.0


@dataclass(slots=True)
class Executor:
    """Carries out the change of ``driver`` on the running system."""

    driver: ActionDriver
    store: StateStore
    # Whether ``run`` was cancelled between two rounds, while it rolled back, or when every step was done.
    interrupted: bool = False
    _starts: EarlyStarts = field(init=False)
    _performer: ActionPerformer = field(init=False)
    _back: RollBack = field(init=False)
    _began: float = 0.0  # steady s
    _described: dict[int, str] = field(default_factory=dict)  # those of each step that has begun
    _done: DoneActions = field(default_factory=list)
    _times: dict[int, StepTime] = field(default_factory=dict)
    _order: StepOrder = field(init=False)
    _last: int = -1  # the last step of the round
    _looked_up: int = 0  # the number of steps up to which early starts have begun
    _awaited: set[int] = field(default_factory=set)  # the steps that were late

    def __post_init__(self) -> None:
        self._starts = EarlyStarts(self.driver, self.store)
        self._performer = ActionPerformer(self.driver, self.store)
        self._back = RollBack(self._performer, self._starts)

    @property
    def change(self) -> RunningChange:
        return self.driver.change

    @property
    def system(self) -> RunningSystem:
        return self.driver.system

    @property
    def times(self) -> list[StepTime]:
        """The durations of the steps that are done, in their order."""
        return [self._times[index] for index in sorted(self._times)]

    async def run(self, overlap: Overlap | None = None) -> None:
        """Carry out the plan's actions in order; ``overlap``: which at once, and which processes start ahead.

        Raises StepFailed after the roll-back; its ``outcome`` says whether that succeeded. If cancelled, it rolls back
        as well, and raises CancelledError where that succeeded. A roll-back is not broken off, and when every step is
        done, nothing is rolled back any more: ``interrupted`` says then that it was cancelled.
        """
        self.change.happened(ChangeEvent.BEGUN)
        self._began = self.driver.backend.clock.steady()
        actions = self.change.actions
        overlap = overlap or one_by_one(actions)
        self._order = order = StepOrder(
            [*overlap.rounds], lambda: self.change.plan.dependencies, _programs_last(actions)
        )
        while indices := order.next() or tuple(order.late[:1]):
            failures: dict[int, BaseException]
            try:
                if self.change.partial and not self.interrupted:
                    indices = await self._in_time(indices, overlap)
                    if not indices:
                        continue
                for index in indices:
                    self._described[index] = actions[index].describe(self.system.configuration)
                    self.driver.events.add(
                        "step", self._numbered(index, self._described[index]), **self._position(index)
                    )
                if self.interrupted:  # since the round before has ended
                    raise asyncio.CancelledError
                self.change.require(indices)
                await self.change.entry.step(*(self._described[index] for index in indices))
                self._starts.check()
                if isinstance(action := actions[indices[0]], Create) and not action.instance.component.once:
                    await self._starts.start(action)
                self._begin_ahead(indices[0], overlap)
                self._last = indices[-1]
                failures = await self._round(indices) or await self._watch_settings(indices)
            except StartFailedEarly as early:  # not this step has failed, but a later one
                failures = {actions.index(early.action): early.error}
            except (Exception, asyncio.CancelledError) as error:
                failures = {indices[0]: error}
            await run_to_completion(self._starts.at_rest(), self._interrupt)
            for index in sorted(self._times.keys() & indices):  # of a round when all of it has ended
                self.driver.events.add("step_done", self._numbered(index, "done"), **self._position(index))
            if failures and not await run_to_completion(self._leave_out(indices, failures), self._interrupt):
                await run_to_completion(self._fail(indices, failures), self._interrupt)
        await run_to_completion(self._starts.stop(), self._interrupt)
        if left_out := self.change.left_out:
            await run_to_completion(self._back.abandon(actions), self._interrupt)
            because = "; ".join(f"{role} is left out: {why}" for role, why in sorted(left_out.items()))
            self.change.happened(ChangeEvent.LEFT_OUT, because)
        else:
            self.change.happened(ChangeEvent.ALL_DONE)

    def _begin_ahead(self, first: int, overlap: Overlap) -> None:
        """Start the processes of later creations that may start now: the steps before ``first`` are done."""
        numbers, self._looked_up = range(self._looked_up, first + 1), max(self._looked_up, first + 1)
        ahead = [index for number in numbers for index in overlap.starts.get(number, ()) if index > first]
        actions = (self.change.actions[index] for index in ahead if not self._order.is_blocked(index))
        self._starts.begin(action for action in actions if isinstance(action, Create))

    async def _in_time(self, indices: tuple[int, ...], overlap: Overlap) -> tuple[int, ...]:
        """In a partial change, the steps of a round that are taken now: not those whose processes take so long.

        These are of programs that have not come up, or have not ended though they are to. They are postponed. Where
        nothing else is left to be done, it waits for the first of them.
        """
        launcher, order = self.driver.launcher, self._order
        actions = [action for index in indices if isinstance(action := self.change.actions[index], Create)]
        if not actions or self._awaited.issuperset(indices):
            return indices
        if indices[0] in order.late:
            late = {each: next(iter(self.change.actions[each].instances())) for each in order.late}
            first = await launcher.pending.first_decided(late.values())
            index = next((each for each, name in late.items() if name == first), indices[0])
            order.resume(index)
            self._awaited.add(index)
            return ()
        if actions[0].instance.component.once and not order.leaves(indices):
            return indices
        for action in actions:
            await self._starts.start_before(action)
        self._begin_ahead(indices[0], overlap)
        undecided = {action.instance.name: index for action, index in zip(actions, indices, strict=True)}
        while undecided and (decided := await launcher.pending.first_decided(undecided, LATE)) is not None:
            del undecided[decided]
        for index in undecided.values():
            order.postpone(index)
        return tuple(index for index in indices if index not in undecided.values())

    def _interrupt(self) -> None:
        self.interrupted = True

    def _name(self, index: int) -> str:
        return self._described.get(index) or self.change.actions[index].describe()

    def _position(self, index: int) -> dict[str, Any]:
        return {"index": index, "total": len(self.change.actions), "step": self.change.preview.steps[index]}

    def _numbered(self, index: int, words: str) -> str:
        return f"{index + 1}/{len(self.change.actions)} {words}"

    async def _round(self, indices: Sequence[int]) -> dict[int, BaseException]:
        """Take the steps of one round. Returns which of several have failed; raises what a single one raises.

        If cancelled, or if one fails, it waits for the others to end, in bounded time, so that none is left incomplete.
        """
        if isinstance(self.change.actions[indices[0]], Handover):
            return await self._hand_over(indices)
        if len(indices) == 1:
            await self._take(indices[0])
            return {}
        held = self._performer.lock_for(self.change.actions[indices[0]])
        async with held or contextlib.nullcontext():
            taking = [asyncio.ensure_future(self._take(index, place)) for place, index in enumerate(indices)]
            try:
                await asyncio.wait(taking)
            finally:
                errors = await asyncio.gather(*map(asyncio.shield, taking), return_exceptions=True)
        for index in indices if held else ():
            await self.change.performed(self.change.actions[index])
        return {index: error for index, error in zip(indices, errors, strict=True) if error is not None}

    async def _watch_settings(self, indices: Sequence[int]) -> dict[int, BaseException]:
        """Once a round has set the last parameters of the change, watch. Returns which step has broken a contract."""
        instances = {
            action.instance: index
            for index in indices
            if isinstance(action := self.change.actions[index], SetParameters)
        }
        if not instances or not self.driver.settings.complete:
            return {}
        try:
            await self.driver.settings.watch()
        except BrokenBySetting as error:
            return {instances.get(error.instance, indices[-1]): error}
        return {}

    async def _hand_over(self, indices: Sequence[int]) -> dict[int, BaseException]:
        """Take hand-overs: prepare all of them at once, cut one after another, and watch all. Returns which failed.

        If cancelled, or as soon as one fails, no further cut begins, and those that are only waited for are given up.
        """
        turns = CutTurns()

        async def take(index: int, place: int | None, turn: CutTurn) -> None:
            try:
                await self._take(index, place, turn)
            except BaseException:
                turns.give_up()
                raise

        places: Sequence[int | None] = range(len(indices)) if len(indices) > 1 else [None]
        taking = [
            asyncio.ensure_future(take(index, place, turns.add())) for index, place in zip(indices, places, strict=True)
        ]
        try:
            await asyncio.wait(taking)
        finally:
            turns.give_up()
            errors = await asyncio.gather(*map(asyncio.shield, taking), return_exceptions=True)
        return {index: error for index, error in zip(indices, errors, strict=True) if error is not None}

    async def _take(self, index: int, place: int | None = None, turn: CutTurn | None = None) -> None:
        """Carry out one step until everything is done that belongs to it; ``place``: in its round, unless alone."""
        action, clock = self.change.actions[index], self.driver.backend.clock
        key = _estimates(action, self.system.configuration, self.change.actions) if place is None else None
        begun = clock.steady()
        await self._step(action, held=place is not None and self._performer.lock_for(action) is not None, turn=turn)
        took = clock.steady() - begun
        if isinstance(action, Handover) and not self.change.brief:  # how long a probation takes is known
            took = max(0.0, took - self.change.plan.change.probation(action))
        self.change.entry.took(took, key, place or 0)
        if turn is not None:
            turn.ended = True
            await turn.turns.waiting(self.driver.watch(action))
        if self._order.ended and index == self._last:
            await self.driver.await_inputs()
        await self.change.step_done(self.system.configuration)
        self._times[index] = StepTime(index + 1, round(begun - self._began, 6), round(clock.steady() - begun, 6))

    async def _step(self, action: Action, *, held: bool, turn: CutTurn | None) -> None:
        """Perform ``action`` and note that it is done; ``held``: its round holds the lock for commands.

        If cancelled, it first waits for the action to end, in bounded time, so that no step is left incomplete. Only a
        creation is interrupted: it cleans up after itself. So it is as soon as a process started ahead has failed: this
        one may be waiting for that one, and would be blamed.
        """
        if isinstance(action, Create) and action.instance.component.once:
            performing = asyncio.ensure_future(self._run_program(action))
        else:
            performing = asyncio.ensure_future(
                self._performer.perform_locked(action) if held else self._performer.perform(action, turn)
            )
        try:
            if isinstance(action, Create):
                await self._starts.wait(performing)
            before = await asyncio.shield(performing)
        except (asyncio.CancelledError, StartFailedEarly):
            if isinstance(action, Create):
                performing.cancel()
            await asyncio.wait({performing})
            if not performing.cancelled() and performing.exception() is None:
                self._done.append((action, performing.result()))
            raise
        self._done.append((action, before))
        if not held:
            await self.change.performed(action)

    async def _leave_out(self, indices: Sequence[int], failures: Mapping[int, BaseException]) -> bool:
        """In a partial change, end the instances of the failed steps and leave them out; whether that is possible.

        It is where the change creates all of them, and the manager continues. What has lost their support is lowered
        by the caller of the change.
        """
        change, life = self.change, self.system.life
        created = {action.instance.name: action.instance for action in change.actions if isinstance(action, Create)}
        failed: dict[str, str] = {}
        for index, error in failures.items():
            names = change.actions[index].instances()
            if not isinstance(error, MidstrideError) or isinstance(error, Superseded) or not created.keys() >= {*names}:
                return False
            gone = [name for name in names if life.is_gone(name)]  # of several that fail in one step, these are why
            failed |= dict.fromkeys(gone or names, str(error))
        if not change.partial or not await change.entry.failed([indices.index(index) for index in failures]):
            return False
        for index in failures:
            words = f"{self._name(index)} failed: {failures[index]}"
            self.driver.events.add("step_failed", words, **self._position(index))
        for name, why in failed.items():
            instance = created[name]
            if (problem := await self.driver.launcher.abandon(name)) is not None:
                self.driver.events.add("note", f"{name} could not be terminated: {problem}")
            exited = life[name].exit if life.has_exited(name) else None
            exited = exited or Exited(name, None)
            life.missed(name, instance.role, replace(exited, because=why.partition("\n")[0].rstrip(":")))
            if name in self.system.configuration.instances:
                self.system.moved(self.system.configuration.without_instance(name))
            self.store.remove_instance(name)
            change.left_out[instance.role] = why
            self.driver.events.add("left_out", f"{instance.role} is left out: {why}")
        self._done = [(action, before) for action, before in self._done if failed.keys().isdisjoint(action.instances())]
        own = (index for index, action in enumerate(change.actions) if not failed.keys().isdisjoint(action.instances()))
        self._order.leave_out(own)
        return True

    async def _run_program(self, action: Create) -> Configuration:
        """Start the program of a creation, which ends, and wait until it has; see :meth:`ActionPerformer.perform`."""
        await self._starts.start(action)
        return await self._performer.perform(action)

    async def _fail(self, indices: Sequence[int], failures: Mapping[int, BaseException]) -> None:
        """Roll back, and raise StepFailed: ``failures`` are those of the steps at ``indices``, by index."""
        reasons = {
            index: await failure_reason(self.driver, self.change.actions[index], error)
            for index, error in failures.items()
            if not isinstance(error, GivenUp)
        }
        for index in failures:
            how = f"failed: {reasons[index]}" if index in reasons else "given up"
            self.driver.events.add("step_failed", f"{self._name(index)} {how}", **self._position(index))
        because = "; ".join(f"{self._name(index)}: {why}" for index, why in reasons.items())
        errors = [failures[index] for index in reasons]
        error = next((each for each in errors if isinstance(each, asyncio.CancelledError | Superseded)), errors[0])
        failed = [place for place, index in enumerate(indices) if index in failures]
        if isinstance(error, Superseded) or not await self.change.entry.failed(failed):
            # What runs is the other manager's.
            await self._starts.stop()
            because += "; nothing is rolled back, since another manager has taken over"
            self.change.happened(ChangeEvent.SUPERSEDED, because)
            raise StepFailed(because, "failed") from error
        self.change.happened(ChangeEvent.STEP_FAILED, because)
        await self._starts.stop()
        begun = min([indices[0], *self._order.late])
        problems = await self._back.abandon(self.change.actions[begun:])
        if any(isinstance(each, EndUnknown) for each in errors):
            problems.append("what has been done stays, as nothing can return to an instance that may end at any time")
            because += f"; {'; '.join(problems)}"
        elif problems := [
            *problems,
            *await self._back.run(self._done, [self.change.actions[each] for each in failures]),
        ]:
            because += f"; and the roll-back failed: {'; '.join(problems)}"
        self.change.happened(ChangeEvent.NOT_UNDONE if problems else ChangeEvent.UNDONE, because)
        if isinstance(error, asyncio.CancelledError) and not problems:
            raise error
        raise StepFailed(because, "failed" if problems else "rolled_back") from error


def _programs_last(actions: Sequence[Action]) -> frozenset[int]:
    """The steps of programs that end (`once`) after which no other follows: they may need what all others offer."""
    found: set[int] = set()
    for index, action in reversed([*enumerate(actions)]):
        if not (isinstance(action, Create) and action.instance.component.once):
            break
        found.add(index)
    return frozenset(found)


def _estimates(action: Action, configuration: Configuration, actions: Sequence[Action]) -> str | None:
    """The key under which durations like that of ``action`` are estimated (:meth:`Change.seconds`)."""
    match action:
        case Create(instance):  # beside others, a process starts more slowly
            alone = sum(isinstance(each, Create) for each in actions) == 1
            return measured_key("create", instance) if alone else None
        case Remove(name):
            return measured_key("remove", configuration.instances[name])
    return action.kind
