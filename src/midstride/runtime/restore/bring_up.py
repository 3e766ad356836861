"""Bringing a system up: finds what an earlier manager left, finishes or rolls back its change, and restores the rest.

Each of these is an ordinary plan (docs/protocols/recovery.md); what still runs is found by :mod:`.recovery`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from immutables import Map

from midstride.errors import CommandRefused, ManagerError, PlanRefused, StepFailed
from midstride.model.specification import Specification, handover_seconds
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.runtime_values import of_change
from midstride.plan.state_continuity import left_behind
from midstride.plan.strategies.registry import planner
from midstride.plan.strategies.restore import restore
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.handover.state_transfers import has_left_state, import_state, keeps_state
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.answering_instance import have_answer
from midstride.runtime.records.journal_records import Interrupted
from midstride.runtime.records.state_store import LeftState, SavedState
from midstride.runtime.restore.earlier_system import require_same_platform
from midstride.runtime.restore.half_done import HalfDone
from midstride.runtime.restore.half_done_values import HalfDoneValues
from midstride.runtime.restore.recovery import recover
from midstride.runtime.restore.restoring import Restorer


@dataclass
class BringUp:
    """One ``up`` of the system ``workspace``, with what ``session`` works with as well."""

    session: ChangeSession
    restorer: Restorer
    options: SystemOptions
    workspace: str
    # Whether it was cancelled during a change, which its roll-back or its end has not shown.
    _broken_off: bool = False

    def __post_init__(self) -> None:
        shared = self.session
        self.system, self.client, self.launcher = shared.system, shared.client, shared.launcher
        self.events, self.store, self.reconciler = shared.events, shared.store, shared.reconciler
        self.backend = shared.backend.name

    async def restore_missing(self, absent: set[str], *, is_new: bool) -> dict[str, str]:
        """Bring up what does not run, without the roles ``absent``; returns why each of the others could not be.

        One that cannot be started does not keep the others down, or the manager from managing what runs. Raises
        StepFailed or PlanRefused where nothing would run, or all roles do; of a strict system, where none ran before
        and one cannot be started.
        """
        present = self.system.configuration.instances_by_role
        gone = [role for role in self.system.specification.roles() if role not in absent and not present.get(role)]
        alone = not self.system.configuration.instances
        missing: dict[str, str] = {}
        try:
            while left_out := await self._complete(
                {*absent, *missing},
                self.system.specification,
                is_new=is_new and not missing,
                partial=not (alone and self.options.strict),
            ):
                missing |= self._failed(left_out)
                await self.reconciler.reconcile_all(f"{', '.join(left_out)} could not be started")
        except (PlanRefused, StepFailed) as error:
            if alone or not gone or self._broken_off:
                raise
            missing = dict.fromkeys(gone, str(error))
            for role in gone if len(gone) > 1 else ():
                try:
                    await self._complete({*absent, *missing} - {role}, self.system.specification)
                except (PlanRefused, StepFailed) as error:
                    missing[role] = str(error)
                else:
                    del missing[role]
        nodes = self.system.specification.nodes
        if missing and not self.system.configuration.instances and not any(nodes[role].respawn for role in missing):
            raise StepFailed("; ".join(missing.values()), "rolled_back")
        return missing

    def _failed(self, left_out: dict[str, str]) -> dict[str, str]:
        """Return which of ``left_out`` are not tried again: but the ones whose container exited or hung with another.

        That other one is apart from them from now on, and counts as failed.
        """
        nodes, apart = self.system.specification.nodes, self.system.apart
        at_fault = {apart[role] for role in left_out if role in apart}
        return {role: why for role, why in left_out.items() if role in apart or nodes[role].container not in at_fault}

    async def finish(self, absent: Collection[str], interrupted: Sequence[Interrupted]) -> bool:
        """Finish the change that an earlier manager began, if that is the system's policy; whether that was possible.

        If not, the caller rolls it back.
        """
        if not interrupted or not self.options.finish_interrupted:
            return False
        change = interrupted[-1]
        if change.target == self.system.specification:
            return False
        try:
            await self._complete(absent, change.target)
        except (PlanRefused, StepFailed) as error:
            if isinstance(error, StepFailed) and error.outcome != "rolled_back":
                raise
            self.events.add("note", f"`{change.command}` was interrupted, and cannot be finished: {error}")
            return False
        return True

    async def _complete(
        self, absent: Collection[str], specification: Specification, *, is_new: bool = False, partial: bool = False
    ) -> dict[str, str]:
        """Bring up the part of ``specification`` that does not run, without the roles ``absent``; ``is_new``: none ran.

        Returns the roles that a ``partial`` change has left out, and why: what relies on them is lowered, and the rest
        is for the next call. Raises StepFailed after a roll-back.
        """
        if self._broken_off:
            raise asyncio.CancelledError
        system = self.system
        running = system.specification
        target = specification
        for role in absent:
            if role in target.nodes:
                target = target.without_node(role)
        change = change_between(self.system.configuration, running, target, apart=system.apart)
        values, configuration = self.system.values, self.system.configuration
        unknown = values.unknown_by_role(configuration)
        parameters = of_change(change, values.by_role(configuration), unknown=unknown)
        if specification == running and not (change.instances() or change.parameters or change.renamed):
            # Nothing but modes differs: what the local reflex has degraded waits until its input is back.
            plan = restore(self.system.configuration, running, self.restorer.improved(change.pending), {})
            change = plan.change
        else:
            plan = replace(await asyncio.to_thread(self._plan, change), parameters=parameters)
        # Before any component has the token.
        reach = self.session.backend.reach()
        origin = (system.file, system.changed_since)
        self.store.begin(self.backend, self.client.token, running, self.options, *origin, reach)
        if (refused := self.session.planner.ends_others(plan)) is not None:  # they are not meant: no command has asked
            if specification != running:
                raise PlanRefused(refused)
            self.events.add("note", f"what an earlier manager has left half done stays as it is: {refused}")
            return {}
        if plan.steps or specification != running:
            begun = await self.session.begin(plan, specification, "up", is_new=is_new, partial=partial, required=False)
            outcome = await self.session.carry_out(begun)
            self._broken_off = begun.recording.broken_off.is_set()
            if self._broken_off and outcome.outcome in ("rolled_back", "incomplete"):
                raise asyncio.CancelledError  # the manager is to end, and begins no other change
            if outcome.outcome not in ("done", "incomplete"):
                raise StepFailed(str(outcome.because), outcome.outcome)
            return begun.left_out
        self.system.configuration = change.in_target_context(self.system.configuration)
        return {}

    def _plan(self, change: Change) -> Plan:
        """The plan for ``change``.

        An interrupted change may have taken the topics from what it was to replace, which holds state still: a
        replacement beside that would start with its own, so it is removed first. Then so is all that is replaced;
        unless no such plan is possible. Raises PlanRefused.
        """
        plan = planner("minimal")(change)
        left = left_behind(change, [step.action for step in plan.steps])
        if any(new in left and keeps_state(self.client, old) for old, new in change.replaced.items()):
            with suppress(PlanRefused):
                return planner("paper")(change)
        return plan

    async def set_back(self, interrupted: Sequence[Interrupted]) -> None:
        """Roll back the settings of parameters that an earlier manager has begun and not watched to their end."""
        for change in interrupted:
            running = self.system.configuration.instances
            before = {running[name].role: values for name, values in change.settings if name in running}
            if not before:
                continue
            request = PlanRequest(parameters=tuple((role, Map(values)) for role, values in before.items()))
            try:
                plan, target = await self.session.planner.plan(request)
                if plan.steps:
                    begun = await self.session.begin(plan, target, request.describe(), "up", required=False)
                    outcome = await self.session.carry_out(begun)
                    if begun.recording.broken_off.is_set():
                        raise asyncio.CancelledError
                    if outcome.outcome != "done":
                        raise PlanRefused(str(outcome.because))
            except PlanRefused as error:
                self.events.add("note", f"`{change.command}` was interrupted, and cannot be rolled back: {error}")

    async def recover(self, saved: SavedState, interrupted: Sequence[Interrupted]) -> set[str]:
        """Find what an earlier manager left, and degrade what is without support.

        Returns the roles of components that are started by hand and do not run: nothing can restore these. Raises
        ManagerError if a component hangs, or the earlier manager ran another system.
        """
        require_same_platform(saved, self.workspace, self.backend, self.session.backend.reach())
        if saved.specification != self.system.specification:
            raise ManagerError(
                f"{self.workspace} is running with another specification; "
                "`midstride apply` changes a running system, `midstride down` ends it"
            )
        self.system.values.saved, self.system.apart = dict(saved.values), dict(saved.apart)
        values = HalfDoneValues(self.client, self.system.values, saved.carried, self.system.specification, interrupted)
        half_done = HalfDone(self.launcher, self.client, self.events, values)
        targets = [change.target for change in interrupted]
        waiting = {role: left.exporter for role, left in saved.exported.items()}
        self.system.configuration = await recover(
            saved.instances, self.system.specification, half_done, targets, waiting, saved.silent
        )
        self.store.write_carried({})
        for role, left in saved.exported.items():
            await self._give_back(role, left)
        running = self.system.configuration.instances
        silent = self.system.life.silent
        known = [each.instance for each in saved.instances if each.instance.name not in silent]
        gone = [each for each in known if each.name not in running]
        for instance in gone:
            if not instance.component.once:
                self.system.gone(instance)
        self.store.write_apart(self.system.apart)
        for instance in gone:
            self.store.remove_instance(instance.name)
            if instance.component.once:  # it runs again, or another one counts
                continue
            self.system.life.missed(instance.name, instance.role, Exited(instance.name, None))
        self.system.forget_filled_roles()
        self.reconciler.save_values()
        self.store.write_apart(self.system.apart)
        names = ", ".join(instance.name for instance in gone if not instance.component.once)
        await self.reconciler.reconcile_all(f"{names} exited" if names else "what it relied on was gone")
        if any(isinstance(error, CommandRefused) for error in self.reconciler.pending.values()):
            await self.reconciler.reconcile()  # its state had just changed
        if pending := self.reconciler.pending:
            words = "; ".join(
                f"{ref} lacks what it relies on, and could not be degraded: {e}" for ref, e in pending.items()
            )
            raise ManagerError(f"{words}. End the process that hangs with `kill -9`, then run `midstride up` again")
        present = self.system.configuration.instances_by_role
        return {each.role for each in gone if each.component.run is None and not present.get(each.role)}

    async def _give_back(self, role: str, left: LeftState) -> None:
        """Have the instance of ``role`` import the state ``left``, unless it has exported it; without one, it waits."""
        self.system.exported[role] = left
        for instance in self.system.configuration.instances_of(role):
            latest = self.system.life.latest(instance.name)
            if latest is None or latest.state.uuid != left.exporter:
                longest = handover_seconds(self.system.specification.timing, "state_timeout")
                failed = await import_state(self.client, instance, left, longest, lenient=True)
                self.events.add("note", has_left_state(instance) if failed is None else failed)
                await have_answer(self.client, instance.name)
            self.store.write_exported(role, None)
            self.system.exported.pop(role, None)
