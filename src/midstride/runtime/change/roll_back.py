"""Takes back what a change has done before one of its steps failed (docs/semantics.md F6)."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from midstride.errors import BackendError
from midstride.model.action import Action, Attach, Create, Handover, Remove, SetParameters
from midstride.model.configuration import Configuration
from midstride.model.wording import counted
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.change.action_performer import ActionPerformer
from midstride.runtime.change.early_starts import EarlyStarts
from midstride.runtime.change.step_failure import error_words
from midstride.runtime.running_system import RunningSystem

_SUPERSEDED: Final = "another manager has taken over"
# The actions that are done, each with the configuration that it was applied to.
DoneActions = list[tuple[Action, Configuration]]


@dataclass(frozen=True, slots=True)
class RollBack:
    """The way back of the change of ``performer``; ``starts`` starts again what the change has removed."""

    performer: ActionPerformer
    starts: EarlyStarts

    @property
    def driver(self) -> ActionDriver:
        return self.performer.driver

    @property
    def system(self) -> RunningSystem:
        return self.performer.driver.system

    async def run(self, done: DoneActions, failed: Sequence[Action] = ()) -> list[str]:
        """Undo the actions in ``done``, last first. Returns what failed; the other actions are undone.

        Removals in a row are carried out at once, and processes of creations in a row start side by side. An instance
        that the change itself created is removed in any case: if it does not answer, it is killed. One that may publish
        on a host that cannot be reached keeps its topics: ``failed`` are the actions that may have been carried out.
        """
        if not done:
            return list(self.driver.fences.problems())
        self.driver.events.add("rollback", f"rolling back {counted(len(done), 'step')}", total=len(done))
        if self._is_superseded():
            return [_SUPERSEDED]
        created = {action.instance.name: action.instance.role for action, _ in done if isinstance(action, Create)}
        await self._kill(name for name in sorted(created) if self.system.life.responsive(name) is None)
        problems = list(self.driver.fences.problems())
        kept = self._taken_over(done)
        undoing = (
            each
            for action, before in reversed(done)
            if not kept & set(action.instances())
            for each in action.undo(before)
        )
        for kind, actions in itertools.groupby(undoing, type):
            row = list(actions)
            if self._is_superseded():  # what runs is the other manager's
                return [*problems, _SUPERSEDED]
            if kind is Remove:
                found = await asyncio.gather(*(self._undo(each, created, failed) for each in row))
            else:
                self.starts.begin(each for each in row if isinstance(each, Create))
                found = [await self._undo(each, created, failed) for each in row]
                await self.starts.stop()
            problems += filter(None, found)
        problems += self.driver.not_answering()
        if not problems:
            self.driver.events.add("rolled_back", "every step has been undone")
        return problems

    def _is_superseded(self) -> bool:
        return self.driver.client.superseded()

    def _taken_over(self, done: DoneActions) -> set[str]:
        """The fenced instances and those that have taken over from them: a topic does not go back to one that hangs."""
        fenced = self.system.life.fenced
        swaps = [swap for action, _ in done if isinstance(action, Handover) for swap in action.swaps]
        return {*fenced, *(swap.new.instance for swap in swaps if swap.old.instance in fenced)}

    def _publishes_elsewhere(self, undoing: Action, created: Mapping[str, str], failed: Sequence[Action]) -> str | None:
        """An instance on a host that cannot be reached which may publish what ``undoing`` attaches an output for."""
        configuration, life = self.system.configuration, self.system.life
        if not isinstance(undoing, Attach):
            return None
        undone = configuration.instances.get(undoing.port.instance)
        if undone is None or not configuration.is_output(undoing.port):
            return None
        for name, role in sorted(created.items()):
            if role != undone.role or not life.may_run(name):
                continue
            if name not in configuration.instances:  # nothing has attached it
                continue
            attached = [port for port, _ in configuration.attached_ports(name)]
            attached += [action.port for action in failed if isinstance(action, Attach) and name in action.instances()]
            taking = any(isinstance(action, Handover) and name in action.instances() for action in failed)
            if taking or any(map(configuration.is_output, attached)):
                return name
        return None

    async def _undo(self, undoing: Action, created: Mapping[str, str], failed: Sequence[Action]) -> str | None:
        """Perform ``undoing``; if that fails, again without the instances in ``created``. Returns, and says, why."""
        what = undoing.describe(self.system.configuration)
        if (other := self._publishes_elsewhere(undoing, created, failed)) is not None:
            problem = f"{what}: {other} could not be ended, and may publish there"
            self.driver.events.add("rollback_failed", f"the roll-back is incomplete: {problem}")
            return problem
        if isinstance(undoing, SetParameters) and self.driver.settings.left_as_set(undoing):
            return None
        while True:
            try:
                if isinstance(undoing, Create):
                    await self.starts.start(undoing)  # the next manager must find what was removed and is there again
                await self.performer.perform(undoing)
                await self.driver.change.performed(undoing)
                return None
            except Exception as error:
                problem = f"{what}: {error_words(error)}"
            if not await self._kill(name for name in undoing.instances() if name in created):
                problem = "; ".join([problem, *await self.abandon([undoing])])
                self.driver.events.add("rollback_failed", f"the roll-back is incomplete: {problem}")
                return problem

    async def _kill(self, instances: Iterable[str]) -> bool:
        """Kill the processes of ``instances``, which then count as crashed; whether there was one."""
        killed = False
        for name in instances:
            if self.system.life.has_exited(name) or not self.system.life[name].is_owned:
                continue
            try:
                await self.driver.launcher.kill(name)
            except BackendError as error:
                self.driver.events.add("note", f"{name} could not be killed: {error}")
                continue
            self.driver.events.add("note", f"{name} was created by this change and does not answer: it was killed")
            killed = True
        return killed

    async def abandon(self, actions: Iterable[Action]) -> list[str]:
        """Terminate what was started for ``actions``. Returns why each of the others could not be."""
        problems: list[str] = []
        for action in actions:
            if isinstance(action, Create) and action.instance.name not in self.system.configuration.instances:
                error = await self.driver.launcher.abandon(action.instance.name)
                if error is not None:
                    problems.append(f"{action.instance.name} could not be terminated: {error}")
                else:
                    self.performer.store.remove_instance(action.instance.name)
        return problems
