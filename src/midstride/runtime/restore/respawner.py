"""Restarts nodes that have crashed, as their restart policies say.

A restart is an ordinary plan, carried out as a command in the queue: it waits for the command in progress, and a user's
command waits for it. A command that has restored or removed the node, or changed its policy, cancels the delay
(docs/protocols/faults.md).
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field
from typing import Final

from midstride.model.hosts import host_in_words, word_of_host
from midstride.model.respawn import RespawnPolicy
from midstride.model.wording import counted
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.change.reconciler import Reconciler, ReconciliationObserver
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.reached_hosts import unreached
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.status_forms import RespawnStatus
from midstride.runtime.restore.attempts import Attempts
from midstride.runtime.running_system import RunningSystem
from midstride.verdicts import conditions

log = logging.getLogger(__name__)

# After so many restarts within the window of its policy, a node that runs is not said to be well.
CRASH_LOOP: Final = 2


@dataclass(slots=True)
class _Record:
    """The crashes of one role, as far as they are known.

    ``crashes``: what has been decided on. ``due``: when the next restart begins (steady s); ``carrying_out``: its plan
    has begun; ``falls_back``: it is one as another component; ``by_itself``: one with the others of its container has
    failed; ``silent``: its host cannot be reached, and its lease is over; ``left``: why there is no next one.
    """

    attempts: Attempts = field(default_factory=Attempts)
    crashes: list[Exited] = field(default_factory=list)
    due: float | None = None
    carrying_out: bool = False
    falls_back: bool = False
    by_itself: bool = False
    silent: bool = False
    left: str | None = None
    task: asyncio.Task[None] | None = None


@dataclass(slots=True)
class Respawner(ReconciliationObserver):
    """Restarts crashed nodes by ``session``, each as a command in the queue."""

    system: RunningSystem
    clock: Clock
    events: EventLog
    reconciler: Reconciler
    session: ChangeSession
    _records: dict[str, _Record] = field(default_factory=dict)  # by role
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)
    _stopped: bool = False

    def stop(self) -> None:
        """Restart nothing any more: the system is being taken down, or left to the next manager."""
        self._stopped = True
        for task in self._tasks:
            task.cancel()

    async def close(self) -> None:
        self.stop()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def reconciled(self) -> None:
        """The model is up to date after a crash or a command: decide on new crashes, and cancel what is obsolete."""
        if self._stopped:
            return
        for role, record in list(self._records.items()):
            if record.carrying_out:
                continue
            if self._policy(role) is None or (self.system.has_instance(role) and record.attempts.runs_since is None):
                self._forget(role, record)
        for role, record in self._records.items():
            policy = self._policy(role)
            if record.silent and record.left is not None and policy is not None and not self._is_lost(role):
                record.silent, record.left = False, None
                record.attempts.made.clear()
                self._on_crash(role, record, policy, f"the host of {role} is reached again")
        for role, crashes in self.system.crashes.items():
            policy, record = self._policy(role), self._records.get(role) or _Record()
            if policy is None or self.system.has_instance(role) or record.carrying_out:
                continue
            new = [crash for crash in crashes if not any(crash is known for known in record.crashes)]
            record.crashes = crashes
            if new and record.task is None and record.left is None:
                self._records[role], record.silent = record, new[-1].silent
                self._on_crash(role, record, policy, new[-1].words)

    def status(self, role: str | None) -> RespawnStatus | None:
        """Return whether and when the node of that role, which has crashed, is restarted; None without a policy."""
        record = self._records.get(role or "")
        policy = None if role is None else self._policy(role)
        if record is None or policy is None:
            return None
        number, words, seconds = len(record.attempts.made), "restarting", None
        if record.left is not None:
            words = f"it will not be restarted again: {record.left}"
        elif not record.carrying_out and (because := self.session.permission.refusal(recovery=True)) is not None:
            words = f"it will be restarted when that may happen: {because}"
        elif record.due is not None:
            seconds = max(0.0, round(record.due - self.clock.steady(), 3))
            words += f" in {seconds:.1f} s" if seconds else " after the current command"
        if record.left is None:
            words += f" ({policy.numbered(number)})"
        return RespawnStatus(
            restarting=record.left is None,
            seconds=seconds,
            restarts=number,
            max_retries=policy.max_retries,
            window=policy.window,
            words=words,
        )

    def crash_loop(self, role: str) -> str | None:
        """Return that a node has been restarted again and again, and why it ended last; None where it has not."""
        record, policy = self._records.get(role), self._policy(role)
        if record is None or policy is None or not record.crashes:
            return None
        number = record.attempts.lately(policy, self.clock.steady())
        if number < CRASH_LOOP:
            return None
        return conditions.crashes_again(role, number, policy.window, record.crashes[-1].details)

    def _is_lost(self, role: str) -> bool:
        """Return whether the host of a node cannot be reached now."""
        return self.system.specification.nodes[role].host in unreached(self.session.backend)

    def _policy(self, role: str) -> RespawnPolicy | None:
        node = self.system.specification.nodes.get(role)
        return None if node is None else node.respawn

    def _forget(self, role: str, record: _Record) -> None:
        """A command has restored or removed the node, or removed its policy: what was counted begins anew."""
        del self._records[role]
        if record.task is not None:
            record.task.cancel()
            why = "it runs again" if self.system.has_instance(role) else "it has no restart policy any more"
            self.events.add("respawn", f"the restart of {role} is cancelled: {why}")

    def _on_crash(self, role: str, record: _Record, policy: RespawnPolicy, why: str) -> None:
        """``role`` does not run because of ``why``: plan the next restart, or what comes after the last one."""
        record.attempts.stopped(self.clock.steady())
        node = self.system.specification.nodes[role]
        if record.silent and self._is_lost(role):
            if policy.leaves(node.host):
                self._take_over(role, record, policy, why)
            else:
                self._leave(role, record, f"{host_in_words(node.host)} cannot be reached", f"{why}; ")
            return
        if (number := record.attempts.next(policy)) is not None:
            delay = policy.delay_before(number)
            when = f"in {delay:.1f} s" if delay else "now"
            self.events.add("respawn", f"{why}; restarting {role} {when} ({policy.numbered(number)})")
            self._schedule(role, record, PlanRequest(restart=(role,)), f"respawn {role}", delay)
            return
        used_up = f"{counted(policy.max_retries or 0, 'restart')} within {policy.window:g} s did not help"
        if not policy.falls_back_from(node.component, node.host):
            self._leave(role, record, used_up, f"{why}; ")
            return
        record.attempts.made.clear()  # those of the fallback are counted anew
        self._fall_back(role, record, policy, f"{why}; {used_up}", 0.0)

    def _take_over(self, role: str, record: _Record, policy: RespawnPolicy, why: str) -> None:
        """Have the fallback take the place of a node that is silent where it cannot be reached, again if that fails."""
        if not record.falls_back:
            record.attempts.made.clear()
            self._fall_back(role, record, policy, why, 0.0)
        elif (number := record.attempts.next(policy)) is not None:
            self._fall_back(role, record, policy, why, policy.delay_before(number + 1))
        else:
            self._leave(role, record, f"{counted(policy.max_retries or 0, 'attempt')} to start its fallback failed")

    def _fall_back(self, role: str, record: _Record, policy: RespawnPolicy, why: str, delay: float) -> None:
        node, fallback = self.system.specification.nodes[role], policy.fallback
        assert fallback is not None
        on: tuple[tuple[str, str], ...] = ()
        where = ""
        if policy.fallback_host is not None and policy.fallback_host != node.host:
            on, where = ((role, word_of_host(policy.fallback_host)),), f" on {host_in_words(policy.fallback_host)}"
        when = f" in {delay:.1f} s" if delay else ""
        self.events.add("respawn", f"{why}: {role} is replaced by {fallback}{where}{when}")
        request, words = PlanRequest(replace=((role, fallback),), on=on), f"respawn {role} as {fallback}{where}"
        self._schedule(role, record, request, words, delay)

    def _leave(self, role: str, record: _Record, why: str, event: str = "") -> None:
        record.left = why
        remedy = f"`midstride logs {role}` shows its output, `midstride restart {role}` restores it"
        self.events.add("respawn_ended", f"{event}{role} will not be restarted again: {why}. {remedy}")

    def _schedule(self, role: str, record: _Record, request: PlanRequest, words: str, delay: float) -> None:
        record.due, record.falls_back = self.clock.steady() + delay, bool(request.replace)
        record.task = asyncio.get_running_loop().create_task(self._restart(role, record, request, words, delay))
        self._tasks.add(record.task)
        record.task.add_done_callback(self._tasks.discard)

    async def _restart(self, role: str, record: _Record, request: PlanRequest, words: str, delay: float) -> None:
        failed = None
        await self.clock.sleep(delay)
        outcome = None
        beside: list[tuple[str, _Record]] = []
        try:
            while outcome is None:
                await self.session.permission.until_recovery()
                async with self.reconciler.command(words):
                    if self.session.permission.refusal(recovery=True) is not None:  # since it waits for its turn
                        continue
                    record.carrying_out, record.due = True, None
                    if request.restart and not (beside or record.by_itself):
                        beside = self._of_the_same_process(role)
                        request = PlanRequest(restart=(role, *(other for other, _ in beside)))
                    self.system.counts.respawns.update({role, *(other for other, _ in beside)})
                    outcome = await self.session.change(request, brief=True, by="the restart policy", recovery=True)
                    failed = None if outcome.outcome == "done" else f"{words} failed: {outcome.because}"
        except Exception as error:  # nothing awaits this task, so errors are logged here
            log.exception("%s failed", words)
            failed = f"{words} failed: {error}"
        # One that its container could not load is apart from now on, and the others try again together.
        at_fault = any(each in self.system.apart for each in (role, *(other for other, _ in beside)))
        for each, its in ((role, record), *beside):
            its.carrying_out, its.task = False, None
            its.by_itself = failed is not None and (its.by_itself or (bool(beside) and not at_fault))
            if self.system.has_instance(each):
                if its.silent:  # what has failed meanwhile is not the fault of the fallback
                    its.silent = False
                    its.attempts.made.clear()
                its.attempts.runs_since = self.clock.steady()
            elif failed is not None and (policy := self._policy(each)) is not None and not self._stopped:
                if request.replace and not its.silent:
                    self._leave(each, its, failed)
                else:
                    self._on_crash(each, its, policy, failed)
        self.reconciled()

    def _of_the_same_process(self, role: str) -> list[tuple[str, _Record]]:
        """The nodes that share a container with ``role`` and are to be restarted now: one plan restores all of them.

        The restarts are counted for each of them. Where one has failed, they are restarted one by one from then on, so
        that a node that cannot start keeps no other one away. One with a process for itself is always restarted alone.
        """
        nodes, apart = self.system.specification.nodes, self.system.apart
        container = None if role not in nodes or role in apart else nodes[role].container
        found = []
        for other in () if container is None else self.system.specification.members_of(container):
            record = self._records.get(other)
            if record is None or other == role or other in apart or record.task is None or record.due is None:
                continue
            if record.falls_back or record.by_itself:
                continue
            if record.due <= self.clock.steady() and not self.system.has_instance(other):
                record.task.cancel()
                record.carrying_out, record.due = True, None
                found.append((other, record))
        return found
