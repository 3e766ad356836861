"""Restores what the local reflex has degraded, once what it relies on is back.

docs/protocols/reflex.md. A component degrades a functionality whose assumption breaks;
to raise it again is up to the manager. It does so by an ordinary plan, as a command in the queue, once the input has
kept what the assumption states for some time: the longer, the more often the functionality has fallen lately.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from midstride.model.best import rebalanced
from midstride.model.component import Assumption, FunctionalityRef, InputAlternatives, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate, satisfies
from midstride.model.respawn import RespawnPolicy
from midstride.model.rules import Evaluator
from midstride.model.wording import counted
from midstride.plan.request import PlanRequest
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.change.reconciler import Reconciler, ReconciliationObserver
from midstride.runtime.instance_life import SILENCE
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient, ComponentEvent, Disconnected
from midstride.runtime.process.reached_hosts import unreached
from midstride.runtime.records.events import EventLog
from midstride.runtime.restore.attempts import Attempts
from midstride.runtime.running_system import RunningSystem
from midstride.wire.state import ComponentState, FunctionalityState, LinkState

log = logging.getLogger(__name__)

# For how long what a functionality relies on must be back, and how often it is restored: as a node is restarted, but
# the first time after 1 s.
POLICY: Final = RespawnPolicy(delay=1.0)
# What is due so soon is restored together (s): components report twice a second.
TOGETHER: Final = 0.6
# A call that takes longer than this may hang (s).
HANGS: Final = 0.5
_REMEDY: Final = "`midstride apply` with the system's file restores it"


@dataclass(slots=True)
class _Record:
    """The state of a functionality that the local reflex has degraded.

    ``fallen``: it has not been restored since; ``conditional``: because of a condition, so that it is restored as
    soon as that holds. ``number``: of the next attempt; ``left``: why there is none.
    ``supported_since``: what it relies on is back, and has been since then; ``seen``: its last report (steady s).
    """

    attempts: Attempts = field(default_factory=Attempts)
    fallen: bool = False
    conditional: bool = False
    number: int = 0
    left: str | None = None
    supported_since: float | None = None
    seen: float = 0.0

    def due(self) -> float | None:
        """The time at which it is to be restored, if what it relies on stays (steady s)."""
        if not self.fallen or self.left is not None or self.supported_since is None:
            return None
        return self.supported_since + (0.0 if self.conditional else POLICY.delay_before(self.number))


@dataclass(slots=True)
class Restorer(ReconciliationObserver):
    """Restores functionalities by ``session``, as commands in the queue.

    ``enabled``: False where only commands are to restore them.
    """

    system: RunningSystem
    client: ComponentClient
    clock: Clock
    events: EventLog
    reconciler: Reconciler
    session: ChangeSession
    enabled: bool = True
    _records: dict[FunctionalityRef, _Record] = field(default_factory=dict)
    # What has degraded by an exception or by another client's command, and to which mode: a command restores these.
    _held: dict[FunctionalityRef, int] = field(default_factory=dict)
    _left_out: set[FunctionalityRef] = field(default_factory=set)  # did not answer when they could have been restored
    _cut_off: set[FunctionalityRef] = field(default_factory=set)  # lowered, as a host cannot be reached
    _running: bool = False  # the system is up
    _restoring: asyncio.Task[None] | None = None
    _carrying: dict[FunctionalityRef, int] = field(default_factory=dict)  # what is being restored now

    def stop(self) -> None:
        """Restore nothing any more: the system is being taken down, or left to the next manager."""
        self.enabled = False
        if self._restoring is not None:
            self._restoring.cancel()

    async def close(self) -> None:
        self.stop()
        if self._restoring is not None:
            await asyncio.gather(self._restoring, return_exceptions=True)

    def degraded(self, ref: FunctionalityRef, index: int) -> None:
        """``ref`` has entered that mode, which no command of this manager has asked for."""
        latest = self.client.life.latest(ref.instance)
        if latest is None or not latest.state.functionalities[ref.functionality].reflex:
            self._held[ref] = index

    def cut_off(self, lowered: Collection[FunctionalityRef]) -> None:
        """Restore these once every host is reached again: what they rely on may be there, behind others."""
        self._cut_off.update(lowered)

    def reconciled(self) -> None:
        """A command has ended, or the model follows what has happened: forget what has been restored or removed."""
        modes, self._running = self.system.configuration.modes, True
        if self._cut_off and not unreached(self.session.backend):
            self._left_out |= self._cut_off
            self._cut_off.clear()
        self._held = {ref: index for ref, index in self._held.items() if modes.get(ref, -1) >= index}
        self._left_out = {ref for ref in self._left_out if modes.get(ref)}
        now = self.clock.steady()
        for ref, record in list(self._records.items()):
            if ref in self._carrying:
                continue
            since = record.attempts.runs_since
            lasts = not record.fallen and since is not None and now - since > POLICY.window
            raised = record.fallen and self.client.life.latest(ref.instance) is not None and not self._is_fallen(ref)
            if ref not in modes or lasts or raised:
                del self._records[ref]

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state, or it has disconnected."""
        if isinstance(event, Disconnected) or not self.enabled or not self._running:
            return
        for name, view in event.functionalities.items():
            ref = FunctionalityRef(event.instance, name)
            if ref not in self._carrying and self._is_fallen(ref):
                self._look(ref, view)

    def _is_fallen(self, ref: FunctionalityRef) -> bool:
        """Return whether the local reflex has degraded ``ref``, or it was left out, and the model has followed."""
        latest, configuration = self.client.life.latest(ref.instance), self.system.configuration
        if latest is None or ref not in configuration.modes:
            return False
        view = latest.state.functionalities[ref.functionality]
        return (view.reflex or view.conditional or ref in self._left_out) and configuration.mode(ref).name == view.mode

    def _look(self, ref: FunctionalityRef, view: FunctionalityState) -> None:
        now, record = self.clock.steady(), self._records.setdefault(ref, _Record())
        if not record.fallen or (record.conditional and not view.conditional):
            record.fallen, record.conditional = True, view.conditional
            record.attempts.stopped(now)
            if record.conditional:
                record.number, record.left, record.supported_since = 1, None, None
            else:
                self._count(ref, record)
        gone, record.seen = now - record.seen, now
        if (view.busy or 0.0) > HANGS or ref not in self.improved([ref]):
            record.supported_since = None
        elif record.supported_since is None or gone > SILENCE:
            record.supported_since = now
        due = record.due()
        idle = self._restoring is None or self._restoring.done()
        if due is not None and now >= due and idle and not self._held_back:
            self._restoring = asyncio.get_running_loop().create_task(self._restore(self._due(now + TOGETHER)))

    @property
    def _held_back(self) -> str | None:
        """The reason why nothing may be restored now, if there is one."""
        return self.session.permission.refusal(recovery=True)

    def _count(self, ref: FunctionalityRef, record: _Record, failed: str = "") -> None:
        """Count a fall or a failed attempt to restore; there is another attempt, or the last one has been made."""
        record.supported_since, record.conditional = None, False
        number = record.attempts.next(POLICY)
        if number is not None:
            record.number = number
            return
        record.left = f"{counted(POLICY.max_retries or 0, 'attempt')} within {POLICY.window:g} s did not last{failed}"
        self.events.add("restore_ended", f"{ref} will not be restored again: {record.left}; {_REMEDY}")

    def _due(self, by: float) -> list[FunctionalityRef]:
        return sorted(ref for ref, record in self._records.items() if (at := record.due()) is not None and at <= by)

    async def _restore(self, refs: list[FunctionalityRef]) -> None:
        words, failed = f"restore {', '.join(map(str, refs))}", ""
        try:
            async with self.reconciler.command(words):
                self._carrying = self.improved([ref for ref in refs if self._is_fallen(ref)])
                records = {
                    ref: record for ref, record in self._records.items() if ref in self._carrying and record.fallen
                }
                for ref in refs:
                    if ref not in self._carrying and ref in self._records:
                        self._records[ref].supported_since = None
                if self._held_back:  # since it waits for its turn; the next report of a component asks again
                    self._carrying = {}
                    return
                if not self._carrying:
                    self.events.add("note", f"{words}: what it relies on has gone again, or a command has restored it")
                    return
                for ref, record in records.items():
                    attempt = "(a condition)" if record.conditional else f"({record.number} of {POLICY.limit})"
                    self.events.add("restore", f"what {ref} relies on is back: it is restored {attempt}")
                try:
                    request = PlanRequest(restore=tuple(sorted(self._carrying.items())))
                    outcome = await self.session.change(request, brief=True, recovery=True)
                    failed = "" if outcome.outcome == "done" else f": {words} failed: {outcome.because}"
                except Exception as error:  # nothing awaits this task, so errors are logged here
                    log.exception("%s failed", words)
                    failed = f": {words} failed: {error}"
                for ref, record in records.items():
                    if failed:
                        self._count(ref, record, failed)
                    else:
                        record.fallen, record.attempts.runs_since = False, self.clock.steady()
        except Exception:  # nothing awaits this task, so errors are logged here
            log.exception("%s failed", words)
        finally:
            self._carrying = {}
            if (
                self.enabled
                and not self._held_back
                and (due := [ref for ref in self._due(self.clock.steady()) if self._records[ref].conditional])
            ):
                # A condition that has come to hold meanwhile does not wait for the next report.
                self._restoring = asyncio.get_running_loop().create_task(self._restore(due))

    # -- what is supported -------------------------------------------------------------------------------

    def improved(self, refs: Collection[FunctionalityRef]) -> dict[FunctionalityRef, int]:
        """The better modes of ``refs`` that are supported, and of what is raised with them."""
        attempts = max((self._records[ref].number for ref in refs if ref in self._records), default=1)
        return rebalanced(self.system.configuration, refs, lambda ref: self._highest(ref, ref in refs, attempts))

    def _highest(self, ref: FunctionalityRef, asked: bool, attempts: int) -> int:
        """The best mode that only the model may forbid. Unless ``asked``, what has fallen more often comes later.

        What was degraded because its publisher was is raised with that: whether its other inputs keep what they promise
        is up to its own reflex.
        """
        configuration, record = self.system.configuration, self._records.get(ref)
        now, state = configuration.modes[ref], self.client.life.responsive(ref.instance)
        if now and state is None and not asked:
            self._left_out.add(ref)
        if not now or ref in self._held or state is None or state.waiting is not None:
            return now
        if not asked and record is not None and record.fallen and (record.number > attempts or record.left is not None):
            return now
        view = state.functionalities[ref.functionality]
        if not view.reflex and not view.conditional:
            return 0
        return next((index for index in range(now) if not any(lacking(configuration, ref, index, state))), now)

    def status(self, ref: FunctionalityRef) -> str | None:
        """Return whether and when ``ref`` is restored, in words; None where that is up to commands."""
        record, latest = self._records.get(ref), self.client.life.latest(ref.instance)
        if record is None or not record.fallen or latest is None or not self.enabled:
            return None
        if record.left is not None:
            return f"it will not be restored again: {record.left}; {_REMEDY}"
        if (due := record.due()) is not None:
            if (because := self._held_back) is not None:
                return f"restored when that may happen: {because}"
            return f"restoring in {max(0.0, due - self.clock.steady()):.1f} s ({record.number} of {POLICY.limit})"
        if (latest.state.functionalities[ref.functionality].busy or 0.0) > HANGS:  # it takes no input meanwhile either
            return "restored when its call has returned"
        component = self.system.configuration.component(ref.instance)
        missing = dict.fromkeys(lacking(self.system.configuration, ref, 0, latest.state))
        named = ", ".join(map(component.port_in_words, missing))
        are = "are" if len(missing) > 1 else "is"
        return f"restored when {named or 'what it relies on'} {are} back"


def lacking(configuration: Configuration, ref: FunctionalityRef, index: int, state: ComponentState) -> Iterator[str]:
    """The inputs that should satisfy what mode ``index`` assumes, and do not receive it, as ``state`` reports.

    What the model does not satisfy is not named: whether it will be satisfied shows when its publishers are raised.
    """
    evaluator, component = Evaluator(configuration), configuration.component(ref.instance)
    for assumption in configuration.functionality(ref).modes[index].assumptions:
        ports = [
            name
            for name in _inputs(configuration, ref, assumption)
            if evaluator.input_satisfied(PortRef(ref.instance, name))
        ]
        conditions = component.conditions
        if not any(
            _receives(component.inputs[name], state.ports.get(name, {}).values(), name in conditions) for name in ports
        ):
            yield from ports


def _inputs(configuration: Configuration, ref: FunctionalityRef, assumption: Assumption) -> Iterable[str]:
    """The inputs that may satisfy ``assumption``."""
    if isinstance(assumption, InputAlternatives):
        return assumption.inputs
    inputs = configuration.component(ref.instance).inputs
    return [name for name in configuration.functionality(ref).inputs if satisfies(inputs[name], assumption)]


def _receives(assumption: Predicate, links: Collection[LinkState], condition: bool) -> bool:
    """Return whether one of the attachments has kept the rate, and constraints on fields.

    As the local reflex, nothing is concluded of one that has never received anything, nor of an input without a rate,
    unless it is a condition. Of a client, whether its server does not break its bound.
    """
    if any(link.responses is not None and link.responses.broken for link in links):
        return False
    deadline = assumption.qos.deadline
    rate = 1 / deadline if assumption.rate is None and deadline else assumption.rate
    received = [link for link in links if link.count]
    if (rate is None and not condition) or not received:
        return True
    return any(
        (rate is None or (link.measured is not None and link.measured.meets(rate)))
        and all(each.run == 0 for each in link.fields.values())
        for link in received
    )
