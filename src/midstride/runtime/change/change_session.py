"""The change session: one change from its request to its report.

Have it planned, verify if requested, carry out step by step, measure at the subscribers, report (docs/semantics.md
sections 6 and 7). Verification does not block the event loop.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from msgspec import UNSET, UnsetType, structs

from midstride.errors import BackendError, ManagerError, PlanRefused, StepFailed, Superseded
from midstride.model import wording
from midstride.model.action import Action, Create, Upgrade
from midstride.model.component import PortRef
from midstride.model.specification import Specification
from midstride.model.wording import counted
from midstride.plan.forms.plan_forms import PlanForm, PlanPreview
from midstride.plan.overlap import overlap
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.cancellation import run_to_completion
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.change.change_assessment import change_assessment
from midstride.runtime.change.change_permission import NO_OVERRIDE, ChangePermission, Override
from midstride.runtime.change.change_phases import ChangeEvent
from midstride.runtime.change.change_planner import ChangePlanner
from midstride.runtime.change.crash_during_change import CrashResponse
from midstride.runtime.change.executor import Executor
from midstride.runtime.change.goal_tallies import goal_tallies
from midstride.runtime.change.lost_endpoints import offered
from midstride.runtime.change.other_nodes_losses import nodes_that_ended
from midstride.runtime.change.parameter_transfer import ParameterTransfer
from midstride.runtime.change.reconciler import Reconciler
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.change.runtime_verification import StepVerifier, Verifier
from midstride.runtime.handover.fences import DEFAULT_WAIT
from midstride.runtime.process.reached_hosts import needed_hosts, require_reached, unreached
from midstride.runtime.records.change_report import ChangeTimeline
from midstride.runtime.records.journal import Journal
from midstride.runtime.records.journal_records import NewChange
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.mode_recorder import ModeRecorder
from midstride.runtime.records.reports import Outcome, StepTime, killed_processes
from midstride.runtime.watch.degradation_report import remaining_degradations
from midstride.runtime.watch.degradation_timer import DegradationTimer
from midstride.runtime.watch.other_nodes import OtherNodesWatch
from midstride.runtime.watch.output_tallies import OutputTallies, recorded_topics
from midstride.runtime.watch.subscriber_recording import Recording
from midstride.verdicts import change_facts
from midstride.verify.verdict import Verdict

# Code that raises often does so in its first calls, so the functionalities that a change has raised are watched for
# this many periods after its last step before it is reported, or this long if no rate is known, and the time that a
# report takes to arrive; how long at most (s).
FIRST_CALLS: Final = 3
FIRST_CALLS_WITHOUT_RATE: Final = 0.2
REPORT_DELAY: Final = 0.1
LONGEST_FIRST_CALLS: Final = 1.0


@dataclass(frozen=True, slots=True)
class _Execution:
    """The times at which the steps of a plan ended (steady s), and their durations.

    ``seconds``: how long they took together; ``times``: each of those that were done.
    ``below_baseline_seconds``: for how long each functionality was below its baseline.
    """

    ended: float
    seconds: float
    below_baseline_seconds: dict[str, float]
    times: list[StepTime]


@dataclass
class ChangeSession:
    """Carries out one change at a time, of the command in progress, with what ``reconciler`` works with as well."""

    reconciler: Reconciler
    backend: Backend
    journal: Journal
    verifier: Verifier
    _measured_until: int = 0
    _unreached: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shared = self.reconciler
        self.system, self.client, self.launcher = shared.system, shared.client, shared.launcher
        self.events, self.store, self.commands = shared.events, shared.store, shared.commands
        self.monitor, self.clock = shared.monitor, self.backend.clock
        self.permission = ChangePermission(self.backend, self.events, self.store)
        self.others = OtherNodesWatch(self.backend, self.system)
        self.planner = ChangePlanner(self.system, self.client, self.monitor, self.journal, self.others)

    async def reach_hosts(self, specification: Specification) -> None:
        """Connect to the hosts of ``specification``, as far as they can be reached. Raises BackendError."""
        if not specification.hosts:
            return
        known = set(self._unreached)
        client = self.client
        found = await self.backend.reach_hosts(specification.hosts, client.token, self._on_host, client.superseded)
        self._unreached = dict(found)
        for host, because in found.items():
            if host not in known:
                self.events.add("host", f"host {host} cannot be reached: {because}")

    def _on_host(self, words: str) -> None:
        """A host has been lost, or is reached again: what could not be done on it may be possible now."""
        self.events.add("host", words)
        self.reconciler.reconcile_soon()

    async def change(
        self,
        request: PlanRequest,
        *,
        expected: int | None = None,
        verify: bool = False,
        brief: bool = False,
        wait: float = DEFAULT_WAIT,
        by: str | None = None,
        override: Override = NO_OVERRIDE,
        recovery: bool = False,
    ) -> Outcome:
        """Carry out ``request``; see :meth:`midstride.runtime.manager.Manager.change`.

        ``recovery``: the manager asks for it without a command.
        """
        what = by or f"`{request.describe()}`"
        if (because := self.permission.recorded_refusal(what, override, recovery=recovery)) is not None:
            return self._refuse(because)
        await self._ask_returned()
        if (outdated := self._outdated(expected)) is not None:
            return outdated
        try:
            plan, target = await self.planner.plan(request)
            self.store.require()
            await self.reach_hosts(target)
            if not recovery and await self._reached_again(plan):
                await self.reconciler.reconcile_crashes()  # what has ended meanwhile is known now
                if (outdated := self._outdated(expected)) is not None:
                    return outdated
                plan, target = await self.planner.plan(request)
            running = self.system.configuration
            left = self.launcher.left_on_hosts(running.instances)
            require_reached(self.backend, plan, running, left, self.system.life.silent)
        except (PlanRefused, ManagerError, BackendError) as error:
            return self._refuse(str(error))
        verdict: Verdict | UnsetType = UNSET
        if verify:
            self.events.add("verifying", f"Alloy judges the {len(plan.steps)} steps of the plan")
            verdict = await self.verifier.plan(plan)
            self.events.add("verified", str(verdict), verdict=verdict)
            if not verdict.holds:
                return self._refuse(verdict.words, verdict)
        try:
            change = await self.begin(
                plan,
                target,
                request.describe(),
                by,
                verdict=verdict,
                keep=not request.declared_parameters,
                brief=brief,
                wait=wait,
            )
        except ManagerError as error:
            return self._refuse(str(error), verdict)
        change.require = self.permission.requirement_check(plan, override, recovery=recovery)
        return await self.carry_out(change)

    def _outdated(self, expected: int | None) -> Outcome | None:
        """The outcome where the configuration is not the one of the plan that was shown any more."""
        if expected in (None, self.system.revision):
            return None
        because = "the configuration has changed since the plan was shown; look at the new plan"
        refused = Outcome(outcome="refused", because=because)
        self.system.counts.changed(refused)
        return refused

    async def _ask_returned(self) -> None:
        """Ask the instances whose host has been reached again a moment ago, and that have not reported since.

        What they have done meanwhile is to be known to the plan.
        """
        life, lost = self.system.life, unreached(self.backend)
        names = [
            name
            for name, instance in self.system.configuration.instances.items()
            if instance.host and instance.host not in lost and life.is_unreported(name)
        ]
        if names:
            await asyncio.gather(*map(self.client.observe, names), return_exceptions=True)
            await self.reconciler.reconcile()

    async def _reached_again(self, plan: Plan) -> bool:
        """Try once more to reach the hosts that ``plan`` needs: the cause may have been removed a moment ago.

        Returns whether one is reached now, so that more is known than when the plan was made.
        """
        lost = needed_hosts(plan, self.system.configuration).keys() & unreached(self.backend).keys()
        if lost:
            await self.backend.try_again(lost)
        return not lost <= unreached(self.backend).keys()

    def _refuse(self, because: str, verdict: Verdict | UnsetType = UNSET) -> Outcome:
        self.events.add("outcome", f"refused: {because}", outcome="refused")
        outcome = Outcome(outcome="refused", because=because, verdict=verdict)
        self.system.counts.changed(outcome)
        return outcome

    async def begin(
        self,
        plan: Plan,
        target: Specification,
        command: str,
        by: str | None = None,
        *,
        is_new: bool = False,
        partial: bool = False,
        required: bool = True,
        verdict: Verdict | UnsetType = UNSET,
        keep: bool = True,
        brief: bool = False,
        wait: float = DEFAULT_WAIT,
    ) -> RunningChange:
        """The change that carries ``plan`` out, from now on in the journal; ``is_new``: no system runs yet.
        ``partial``: what cannot be created is left out.

        ``keep``: with the parameter values that were set at run time. ``brief``: new publishers are accepted after
        their first calls, and the next command does not wait for the whole measurement. ``wait``: after how long a hung
        component that is being replaced is fenced (s). Raises Superseded; where the journal is ``required``,
        ManagerError.
        """
        system = self.system
        preview = await asyncio.to_thread(PlanPreview.of, plan)  # which steps of a large plan commute takes a while
        before = None if is_new else system.specification
        new = NewChange(command, by, before, target, len(plan.steps), preview)
        entry = await self.journal.begin(new, required=required)
        hurried = self.commands.another_waits if brief else None
        recording = Recording(self.client, self.clock, hurried, self._measured_until)
        carried = self.store.write_carried
        transfer = ParameterTransfer(self.client, system.values, plan.change, plan.parameters, keep, carried)
        missing = system.life.missing
        change = RunningChange(
            plan,
            target,
            preview,
            entry,
            recording,
            transfer,
            wait,
            system.configuration,
            missing,
            verdict,
            partial,
            brief,
            hurried,
        )
        if verdict is not UNSET:
            seen = tuple(plan.configurations())
            change.observers.append(StepVerifier(self.verifier, seen, system.life, self.events))
        return change

    async def carry_out(self, change: RunningChange) -> Outcome:
        """Carry out ``change``, measure, report, and record it in the journal.

        If cancelled, it rolls back, and raises CancelledError where that has succeeded. Once the plan has ended, or if
        it is being rolled back already, only the measurement is broken off.
        """
        return await run_to_completion(self._recorded(change), change.interrupt)

    async def _recorded(self, change: RunningChange) -> Outcome:
        """The outcome of ``change``; the journal gets it too, with its timeline."""
        since, before = time.time(), self.events.last
        modes = self._mode_recorder(change)
        self.client.listeners.append(modes.on_component_event)
        self.commands.change = change
        self.reconciler.degraded.clear()
        try:
            outcome = await self._carry_out(change)
            self.system.counts.changed(outcome)
        finally:
            self.commands.change = None
            self.client.listeners.remove(modes.on_component_event)
            await change.recording.stop(self.system.configuration.instances)
        await self.backend.leave_hosts(self.system.specification.hosts)
        roles = {role for step in change.plan.steps for role in step.roles}
        timeline = ChangeTimeline(
            since=since,
            until=time.time(),
            modes=modes.intervals(roles, since, self.system.configuration.instances.keys()),
            events=[structs.replace(event, plan=UNSET) for event in self.events.since(before)],
        )
        with suppress(Superseded):
            await change.entry.recorded(outcome, timeline)
        return outcome

    def _mode_recorder(self, change: RunningChange) -> ModeRecorder:
        created = [action.instance for action in change.actions if isinstance(action, Create)]
        recorder = ModeRecorder(self.system.configuration, created, time.time)
        now, steady = time.time(), self.clock.steady()
        for name in self.system.configuration.instances:
            if (latest := self.system.life.latest(name)) is not None:
                recorder.reported(latest.state, now - (steady - latest.at))
        return recorder

    async def _carry_out(self, change: RunningChange) -> Outcome:
        system, plan, recording = self.system, change.plan, change.recording
        events_before = self.events.last
        silent_before = self.monitor.silent(system.configuration)
        afterwards = "".join(
            f"; afterwards {wording.lowered(shift.functionality, shift.after, shift.before)}"
            for shift in plan.level_shifts
            if shift.levels > 0
        )
        steps = counted(len(plan.steps), "step")
        self.events.add("plan", f"{steps}, disruption {plan.disruption:g}{afterwards}", plan=change.preview)
        await recording.begin(system.configuration, change.actions)
        tallies = OutputTallies(self.client, self.clock)
        tallies.begin(system.configuration, change.actions)
        change.observers.append(tallies)
        states = system.life.latest_states
        self.launcher.begin_change()
        goals = dict(self.launcher.goals)
        driver = ActionDriver(
            self.client, self.launcher, self.backend, system, self.events, change, self.store.write_exported
        )
        execution = await self._execute(driver)
        fenced = system.life.fenced
        exited = {name for name in system.life.exits if name in change.before.instances and name not in fenced}
        await self.reconciler.reconcile_crashes()  # before measuring: dependent functionalities must not wait for it
        assert change.outcome is not None
        await change.entry.end(change.outcome, change.because, execution.seconds)
        swaps = await self._measure(driver, execution)
        resumed = change.outcome != "done"
        at_outputs = await tallies.assessments(driver.last_numbers, recorded_topics(swaps), resumed=resumed)
        await self.reconciler.reconcile()  # the report includes unexpected degradations
        silences = {fault.words: fault for fault in [*recording.silences, *self.monitor.faults(system.configuration)]}
        await change.entry.measured(swaps)
        if swaps:
            self.events.add("measured", f"measured at {counted(len(swaps), 'subscriber')}", swaps=swaps)
        planned = plan.change.in_target_context(plan.change.final) if change.outcome == "done" else change.before
        remaining = remaining_degradations(system, change.before, planned)
        before = change.missing_before
        missing = {name for name, event in system.life.missing.items() if before.get(name) is not event}
        outcome = Outcome(
            outcome=change.outcome,
            plan=PlanForm.of(plan, change.preview),
            seconds=execution.seconds,
            steps=execution.times,
            skews=driver.modes.skews,
            below_baseline_seconds=execution.below_baseline_seconds,
            swaps=swaps,
            late=driver.late,
            moved=driver.moved,
            goals=goal_tallies(
                plan, goals, {**self.launcher.goals, **self.launcher.ended_goals}, self.launcher.has_ended
            ),
            own_state={
                name: words
                for name, words in {**driver.own_state, **change.parameters.unknown}.items()
                if name in system.configuration.instances
            },
            fenced=[fenced[name] for name in sorted(fenced)],
            killed=killed_processes(self.events.since(events_before)),
            because=change.because,
            parameters=change.parameters.report(change.outcome == "done"),
            unexpected_exits=sorted(exited | missing),
            unexpected_degradations=sorted(map(str, self.reconciler.degraded)),
            silences=[fault for words, fault in silences.items() if words not in silent_before],
            remaining_degradations=remaining,
            verdict=change.verdict,
        )
        ended = (
            *nodes_that_ended(change, self.launcher.ended_with, system.configuration, self.others.look()),
            *(change_facts.management_not_seen(name, planned=False) for name in sorted(driver.unseen)),
        )
        continuity = change_assessment(
            outcome,
            plan,
            system.configuration,
            list(silences.values()),
            at_outputs,
            states,
            dict(self.launcher.last_known),
            ended,
            offered(system.life.latest_states, system.configuration),
        )
        said = f"{change.outcome}: {change.because}" if change.because else change.outcome
        self.events.add("outcome", "; ".join([said, *continuity.weakest]), outcome=change.outcome)
        return structs.replace(outcome, continuity=continuity)

    async def _execute(self, driver: ActionDriver) -> _Execution:
        """Execute the plan, and roll it back if a step fails; the model then has the target, or what was before.

        If cancelled, it rolls back as well, and raises CancelledError where that has succeeded.
        """
        system, change, plan = self.system, driver.change, driver.change.plan
        started = self.clock.steady()
        system.configuration = plan.change.start
        timer = DegradationTimer(plan.change, self.clock, system.life)
        response = CrashResponse(change, self.reconciler)
        change.observers += [timer, response]
        executor = Executor(driver, self.store)
        try:
            # Alloy judges the configurations of the sequence: what is verified takes one step after another.
            found = await asyncio.to_thread(overlap, plan) if change.verdict is UNSET else None
            await change.take(executor.run(found))
            if change.target != system.specification:
                system.changed_since = True
                self.store.write_specification(change.target)
            system.specification = change.target
            self.permission.follow(change.target.requirements)
            system.configuration = plan.change.in_target_context(system.configuration)
            self.launcher.redeclared(system.configuration.instances.values())
            system.forget_filled_roles()
        except StepFailed:
            system.life.miss_again(change.missing_before, system.configuration.instances)
            system.forget_filled_roles()
            if change.outcome == "rolled_back":
                system.configuration = change.before
        except asyncio.CancelledError:
            if change.outcome == "rolled_back":
                system.configuration = change.before
            await change.entry.end(change.outcome or "failed", "the manager was terminated", None)
            raise
        finally:
            await response.close()
        system.values.forget_ended(system.configuration)
        self.reconciler.save_values()
        self.store.write_apart(system.apart)
        self.store.write_carried({})
        driver.forget_exported()
        ended = self.clock.steady()
        return _Execution(ended, round(ended - started, 6), timer.stop(), executor.times)

    async def _measure(self, driver: ActionDriver, execution: _Execution) -> list[SwapReport]:
        """Report what each subscriber has received, once it has been watched for long enough after the last step."""
        change, recording = driver.change, driver.change.recording
        if recording.recorded:
            self.events.add("measuring", "watching the subscribers for 20 periods more")
        done = change.outcome == "done"
        change.happened(ChangeEvent.WATCHING)
        try:
            swaps = await recording.finish(
                driver.last_numbers,
                first_numbers=driver.first_numbers,
                resumed=not done,
                hung=self.system.life.fenced,
            )
            if done:
                await recording.wait(execution.ended + self._first_calls(change.actions) - self.clock.steady())
            return swaps
        finally:
            change.happened(ChangeEvent.WATCHED)
            hurried = recording.hurried is not None and recording.hurried.is_set()
            self._measured_until = int(self.clock.steady() * 1e9) if hurried else 0

    def _first_calls(self, actions: Sequence[Action]) -> float:
        """The time that the first calls of the functionalities that ``actions`` have raised take (s).

        Of a program without ports only its process shows that it works, so it is watched for the longest time.
        """
        configuration = self.system.configuration
        created = [action.instance.component for action in actions if isinstance(action, Create)]
        if any(not each.functionalities and not each.once for each in created):
            return LONGEST_FIRST_CALLS
        refs = {ref for action in actions if isinstance(action, Upgrade) for ref in action.modes}
        raised = [(ref, found) for ref in refs if (found := configuration.find_functionality(ref)) is not None]
        if not raised:
            return 0.0
        rates = [configuration.rate(PortRef(ref.instance, name)) for ref, found in raised for name in found.outputs]
        rates += [
            configuration.component(ref.instance).inputs[name].rate for ref, found in raised for name in found.inputs
        ]
        calls = max((FIRST_CALLS / rate for rate in rates if rate), default=FIRST_CALLS_WITHOUT_RATE)
        return min(LONGEST_FIRST_CALLS, calls + REPORT_DELAY)
