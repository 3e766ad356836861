"""The reconciler: updates the model after crashes and unexpected degradations, and degrades dependent functionalities.

A crash is an unplanned removal; a component degrades on its own when its code raises. The model is updated to the
actual state; then exactly the functionalities that are lower in `best` of the remaining system are degraded. Upgrades
are left to plans (docs/protocols/faults.md).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Collection, Coroutine, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from midstride.errors import BackendError, CommandRefused, MidstrideError, internal_error
from midstride.model.best import lowered
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.mode_changes import lower_modes
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.handover.new_publishers import DETACH_TIMEOUT
from midstride.runtime.process.component_client import ComponentClient, ComponentEvent, Disconnected
from midstride.runtime.process.launcher import Launcher, maybe_done
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.observed_configuration import (
    changed_attachments,
    differs,
    left_closed,
    own_degradations,
    own_degradations_in,
    unsupported_modes,
    with_attachments,
)
from midstride.runtime.watch.silence import SilenceMonitor
from midstride.wire import commands
from midstride.wire.state import ComponentState

log = logging.getLogger(__name__)

# After how long a component that has refused to degrade a functionality is asked again (s).
REFUSED_INTERVAL: Final = 1.0
# After how long a component that does not detach what a hand-over has left is asked again (s): commands wait meanwhile.
DETACH_INTERVAL: Final = 10.0
_GONE_BEFORE: Final = "what it relied on was gone before it could be degraded"


class ReconciliationObserver:
    """Follows the reconciler. Each method does nothing unless overridden."""

    __slots__ = ()

    def degraded(self, ref: FunctionalityRef, index: int) -> None:
        """``ref`` has entered that mode, which no command of this manager has asked for."""

    def cut_off(self, lowered: Collection[FunctionalityRef]) -> None:
        """Functionalities were degraded, as what is silent on a host that cannot be reached counts as exited."""

    def reconciled(self) -> None:
        """The model is up to date after a command, or after what has happened without one."""


@dataclass
class Reconciler:
    """Handles the events of a back end and of components.

    While a command is changing the system, the command reconciles at its start and its end; otherwise the reconciler
    does so in the background, between commands. ``degraded`` are the functionalities that have degraded unexpectedly
    since the last change began.
    """

    system: RunningSystem
    client: ComponentClient
    monitor: SilenceMonitor
    launcher: Launcher
    events: EventLog
    store: StateStore
    commands: CommandQueue
    observers: list[ReconciliationObserver] = field(default_factory=list)
    degraded: set[FunctionalityRef] = field(default_factory=set)
    pending: dict[FunctionalityRef, MidstrideError | None] = field(default_factory=dict)  # could not be degraded yet
    _why_pending: str = _GONE_BEFORE
    _reconciled_at: float = 0.0  # when a functionality was last degraded, or refused to be (steady s)
    # When an output that could not be detached is tried again, by port and topic (steady s).
    _detach_at: dict[tuple[PortRef, str], float] = field(default_factory=dict)
    _queued: bool = False  # a reconciliation in the background has not begun yet
    _reconciling: asyncio.Lock = field(default_factory=asyncio.Lock)
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def on_exit(self, event: Exited) -> None:
        """A process has exited without being asked to."""
        if self.launcher.exited(event):
            return
        if self.system.life[event.instance].is_owned:
            self._record_exit(event)

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state, or its connection has closed."""
        match event:
            case Disconnected(instance, exited):
                if instance not in self.system.configuration.instances:
                    return
                if not exited:
                    if not self.system.life.is_gone(instance):  # else its exit is known
                        self.events.add("note", f"{instance} cannot be reached any more; its process may still run")
                # The only sign of exit for a component started by hand; for others the back end reports it.
                elif not self.system.life[instance].is_owned:
                    self.launcher.disconnected(instance)
                    self._record_exit(Exited(instance, None))
            case state:
                if self.system.values.report(state):
                    self.save_values()
                self.monitor.on_report(state, self.system.configuration)
                answers_again = self._answers_again(state.instance)
                configuration = self.system.configuration
                degraded = own_degradations_in(configuration, state)
                if degraded and (change := self.commands.change) is not None:
                    change.moved(configuration, (state.instance,))
                wrong = differs(configuration, state) or bool(
                    unsupported_modes(configuration, state) or self._to_detach(left_closed(configuration, state))
                )
                if answers_again or degraded or wrong or self._can_retry(state):
                    self._reconcile_soon()

    def _answers_again(self, instance: str) -> bool:
        """Return whether this is the first report of a component since one of its functionalities was not degraded in
        time.
        """
        found = [ref for ref, error in self.pending.items() if ref.instance == instance and error is not None]
        unanswered = [ref for ref in found if not isinstance(self.pending[ref], CommandRefused)]
        self.pending |= dict.fromkeys(unanswered)
        return bool(unanswered)

    def _can_retry(self, state: ComponentState) -> bool:
        """Return whether a functionality that refused to degrade may accept it now: no call of its code is running."""
        if self._reconciling.locked() or self.monitor.clock.steady() - self._reconciled_at < REFUSED_INTERVAL:
            return False
        pending = [ref for ref, error in self.pending.items() if isinstance(error, CommandRefused)]
        refused = [ref.functionality for ref in pending if ref.instance == state.instance]
        return any(state.functionalities[name].busy is None for name in refused)

    def save_values(self) -> None:
        """Save the parameter values that were set at run time, where they have changed, for the next manager."""
        system = self.system
        for role, values in system.values.update_saved(system.configuration, system.specification.nodes).items():
            self.store.write_values(role, values)

    def _record_exit(self, event: Exited) -> None:
        live = self.system.configuration.instances.get(event.instance)
        hint = "" if live is None else maybe_done(live.component, event)
        if hint:
            event = replace(event, because=f"{event.details}{hint}")
        if (others := self.system.other_nodes.get(event.instance)) is not None and others.nodes:
            event = replace(event, because=f"{event.details}; with it ended {others.in_words}")
        if event.loading:
            self._keep_apart(event.instance)
        self.system.life.exited(event)
        if (role := self._role_of(event.instance)) is not None:
            self.system.counts.crashes[role] += 1
        self.events.add("exited", event.details, log=event.log_tail)
        change = self.commands.change
        if event.instance in self.system.configuration.instances and change is not None:
            change.moved(self.system.configuration, (event.instance,))
        if self.commands.is_changing and change is not None:
            self._in_background(change.crashed())
        else:
            self._reconcile_soon()

    def fell_silent(self, event: Exited) -> None:
        """The host of an instance cannot be reached, and its lease is over: it counts as exited."""
        self.system.life.fell_silent(event)
        self.events.add("note", event.words)
        self._reconcile_soon()

    def _role_of(self, name: str) -> str | None:
        """The role of an instance of the model, or of the change in progress."""
        live, change = self.system.configuration.instances.get(name), self.commands.change
        if live is not None or change is None:
            return None if live is None else live.role
        with contextlib.suppress(KeyError):
            return change.plan.change.role_of(name)
        return None

    def _keep_apart(self, name: str) -> None:
        """A container has exited or hung while it loaded ``name``: the next of its role has a process for itself."""
        if (change := self.commands.change) is None:
            return
        instance = change.plan.change.instance(name)
        if instance.container is None or not instance.process:
            return
        self.system.apart[instance.role] = instance.container.name
        self.store.write_apart(self.system.apart)
        because = f"{instance.process} exited, or did not answer, while it was loading {name}"
        until = f"`midstride restart {instance.container.name}`"
        self.events.add("note", f"{instance.role} is not loaded beside others again until {until}: {because}")

    @contextlib.asynccontextmanager
    async def command(self, words: str, id: str | None = None) -> AsyncIterator[None]:
        """Run one command after those before it, and reconcile before and after it."""
        async with self.commands.run(words, id):
            try:
                await self.reconcile()
                self._accept_reported()
                yield
                await self.reconcile()
            finally:
                # Something happened after that, or the command failed.
                if self.system.life.exits or own_degradations(self.system.configuration, self.system.life):
                    self._start_reconciling()
                self._tell_observers()

    def _tell_observers(self) -> None:
        for observer in self.observers:
            observer.reconciled()

    def _accept_reported(self) -> None:
        """Expect the revisions that components have reported, except of those that report what the model lacks.

        A worst mode that raises changes the revision of its component, and nothing in the model.
        """
        configuration = self.system.configuration
        for name in sorted(configuration.instances):
            state = self.system.life.responsive(name)
            if state is None or own_degradations_in(configuration, state) or differs(configuration, state):
                continue
            self.client.accept(name)

    def _reconcile_soon(self) -> None:
        if not self.commands.is_changing:
            self._start_reconciling()

    def _start_reconciling(self) -> None:
        if not self._queued:
            self._queued = True
            self._in_background(self._reconcile_in_background())

    def _in_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reconcile_in_background(self) -> None:
        async with self.commands.between():
            self._queued = False
            try:
                await self.reconcile()
                self._tell_observers()
            except Exception as error:  # nothing awaits this task, so errors are logged here
                log.exception("reconciling failed")
                self.events.add("note", f"reconciling failed: {internal_error(error)}")

    def reconcile_soon(self) -> None:
        """Reconcile in the background, unless a command is changing the system, which does so at its end."""
        self._reconcile_soon()

    async def reconcile_crashes(self) -> None:
        """Reconcile if a component has crashed, and wait for a reconciliation in progress."""
        if self.system.life.exits or self._reconciling.locked():
            await self.reconcile()

    async def reconcile_all(self, because: str) -> None:
        """Reconcile the whole system: after an earlier manager, any assumption may no longer hold."""
        self.pending, self._why_pending = dict.fromkeys(self.system.configuration.modes), because
        await self.reconcile()
        self._why_pending = _GONE_BEFORE

    async def reconcile(self) -> None:
        """Update the model to the actual state, and degrade functionalities whose assumptions no longer hold.

        Those that cannot be degraded are ``pending``, with the error.
        """
        async with self._reconciling:
            await self._end_left()
            await self.client.send_owed()
            configuration = self.system.configuration
            exits = self.system.life.exits
            crashed = self.system.life.take_exited(configuration.instances)
            for name in exits:  # also one that the model has no more: another process may get its name
                self.client.disconnect(name)
                if name not in configuration.instances:
                    self.store.remove_instance(name)
            for name in crashed:
                self.system.gone(configuration.instances[name])
                self.store.write_apart(self.system.apart)  # first: a manager that is killed in between finds it
                if not self.system.life[name].silent:  # else it is still to be ended
                    self.store.remove_instance(name)
            self.store.write_silent(self.system.life.silent)
            degraded = own_degradations(configuration, self.system.life)
            configuration, touched, because = self._take_over_reported(configuration)
            await self._detach_left(configuration)
            if not crashed and not degraded and not self.pending and not because:
                return
            because += (exits[name].words for name in crashed)
            for name in {ref.instance for ref in degraded}:
                self.client.accept(name)
            for ref, index in sorted(degraded.items()):
                words = f"{ref} entered mode {configuration.functionality(ref).modes[index].name}"
                if ref not in self.pending:  # else a command that timed out has been carried out after all
                    words += " unexpectedly"
                    self.degraded.add(ref)
                    for observer in self.observers:
                        observer.degraded(ref, index)
                self.events.add("degraded", words, functionality=str(ref))
                because.append(words)
            after, to_lower = respond(configuration, crashed, degraded, [*self.pending, *touched])
            self.system.moved(after)
            words = "; ".join(because) or self._why_pending
            failed = await lower_modes(to_lower, words, self.client, self.system, self.events)
            if reached := {ref: index for ref, index in to_lower.items() if ref not in failed}:
                self.system.moved(self.system.configuration.with_modes(reached))
                if any(exits[name].silent for name in crashed):
                    for observer in self.observers:
                        observer.cut_off(reached)
            self.pending, self._reconciled_at = dict(failed), self.monitor.clock.steady()

    def _to_detach(self, left: Iterable[tuple[PortRef, str]]) -> list[tuple[PortRef, str]]:
        """The outputs in ``left`` that have not just been tried in vain."""
        now = self.monitor.clock.steady()
        return [each for each in left if now >= self._detach_at.get(each, 0.0)]

    async def _detach_left(self, configuration: Configuration) -> None:
        """Detach the outputs that a hand-over has left behind a closed gate.

        The old side of a cut writes again once the new one cannot (docs/protocols/cut.md), also long after that has
        handed over to another.
        """
        states = [state for name in sorted(configuration.instances) if (state := self.system.life.responsive(name))]
        left = [each for state in states for each in left_closed(configuration, state)]
        for port, topic in self._to_detach(left):
            detach = commands.DetachCommand(port=port.port, topic=topic, timeout=DETACH_TIMEOUT)
            if await self.client.undo(port.instance, detach):
                self._detach_at.pop((port, topic), None)
                self.events.add("note", f"{port} has been taken off {topic}, where a hand-over had closed its gate")
            else:
                self._detach_at[port, topic] = self.monitor.clock.steady() + DETACH_INTERVAL

    async def _end_left(self) -> None:
        """End what a change has left on a host that could not be reached then."""
        left = self.system.life.left_on_hosts(self.system.configuration.instances)
        if left and self.client.superseded():  # then it is the other manager's
            return
        for name in left:
            with contextlib.suppress(BackendError):  # nor can it now
                await self.launcher.end_left(name)
                self.store.remove_instance(name)
                self.events.add("note", f"{name} could not be terminated before, and has been now")

    def _take_over_reported(
        self, configuration: Configuration
    ) -> tuple[Configuration, list[FunctionalityRef], list[str]]:
        """The configuration with the attachments that components report, what they concern, and what differed.

        They differ where a command timed out and has been carried out all the same, or could not be undone. A better
        mode is accepted only where it lacks support, and so is about to be left: raising is a plan's affair.
        """
        touched: list[FunctionalityRef] = []
        because: list[str] = []
        for name in sorted(configuration.instances):
            state = self.system.life.responsive(name)
            lacking, besides = ([], []) if state is None else changed_attachments(configuration, state)
            for port, connector in lacking:
                because.append(f"{port} is not attached to {connector} any more")
                if configuration.is_output(port):
                    touched += configuration.consumers(connector)
            if lacking:
                touched += [ref for ref in configuration.modes if ref.instance == name]
            because += [f"{port} is attached to {connector}" for port, connector in besides]
            if lacking or besides:
                self.client.accept(name)
                configuration = with_attachments(configuration, lacking, besides)
            if state is not None and (better := unsupported_modes(configuration, state)):
                self.client.accept(name)
                modes = {ref: configuration.functionality(ref).modes[index].name for ref, index in better.items()}
                because += [f"{ref} is in mode {mode}" for ref, mode in modes.items()]
                touched += better
                configuration = configuration.with_modes(better)
        for words in because:
            self.events.add("note", f"{words}, by its own report")
        return configuration, touched, because


def respond(
    configuration: Configuration,
    crashed: Iterable[str],
    degraded: Mapping[FunctionalityRef, int],
    pending: Iterable[FunctionalityRef] = (),
) -> tuple[Configuration, dict[FunctionalityRef, int]]:
    """The configuration without ``crashed`` and with the modes in ``degraded``, and the modes to degrade others to.

    ``pending`` are functionalities that an earlier response could not degrade.
    """
    touched: set[FunctionalityRef] = set(pending)
    for name in crashed:
        for port, connector in configuration.attached_ports(name):
            if configuration.is_output(port):
                touched.update(configuration.consumers(connector))
        configuration = configuration.without_instance(name)
    for ref in degraded:
        for output in configuration.functionality(ref).outputs:
            for connector in configuration.attached_to(PortRef(ref.instance, output)):
                touched.update(configuration.consumers(connector))
    configuration = configuration.with_modes(degraded)
    return configuration, lowered(configuration, [ref for ref in touched if ref.instance in configuration.instances])
