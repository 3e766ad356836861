"""The permission for a change of the running system (docs/protocols/permission.md).

A person may lock the system, for a reason: then no command changes it but `down`. And a specification may state what
has to hold, as ``changes require``, of topics that the manager listens to. What the manager does without a command,
restarting what has crashed and restoring what has degraded, goes on unless the lock or the requirement holds that back
as well.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import BackendError, ChangeForbidden
from midstride.model.contract import format_number
from midstride.model.specification import ChangeRequirement
from midstride.plan.lowering import PlanLowering
from midstride.plan.plan import Plan
from midstride.runtime.backend_protocol import Backend, HeardMessage, TopicListener
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.records.status_forms import ChangeLock, RequirementStatus

# How often a restart that is held back looks whether it may happen, and how often the requirements are looked at while
# nothing asks for a change, so that the status and the log show when one begins or ceases to hold (s).
ASK_AGAIN: Final = 0.5
_UNLOCK: Final = "`midstride unlock` ends that, `--despite-lock` changes the system all the same"
_REQUIRED: Final = "`--despite-requirements` changes the system all the same"


@dataclass(frozen=True, slots=True)
class Override:
    """The reasons against a change that a command overrides deliberately."""

    lock: bool = False
    requirements: bool = False


NO_OVERRIDE: Final = Override()


@dataclass(slots=True)
class ChangePermission:
    """Decides whether changes may happen, and keeps the lock for the next manager. ``now`` gives the UNIX time."""

    backend: Backend
    events: EventLog
    store: StateStore
    now: Callable[[], float] = time.time
    _lock: ChangeLock | None = None
    _expiry: asyncio.Task[None] | None = None
    _listeners: dict[ChangeRequirement, TopicListener | str] = field(default_factory=dict)  # or why there is none
    _shown: list[RequirementStatus] = field(default_factory=list)
    _watching: asyncio.Task[None] | None = None
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)

    # -- the decision ------------------------------------------------------------------------------------

    def refusal(self, override: Override = NO_OVERRIDE, *, recovery: bool = False) -> str | None:
        """The reason why a change must not begin now, or None. ``recovery``: the manager makes it without a command."""
        return self._locked(override, recovery) or self.unmet(override, recovery=recovery)

    def _locked(self, override: Override, recovery: bool) -> str | None:
        lock = self._lock
        if lock is None or override.lock or (recovery and not lock.holds_recovery):
            return None
        return f"{lock.words}; {_UNLOCK}"

    def unmet(self, override: Override = NO_OVERRIDE, *, recovery: bool = False) -> str | None:
        """The requirements that do not hold now, with the reasons; None if all do. A lock does not count here."""
        if override.requirements:
            return None
        found = [each for each in self.requirements() if not each.holds and (each.recovery or not recovery)]
        return f"{'; '.join(each.words for each in found)}; {_REQUIRED}" if found else None

    def overridden(self, override: Override) -> str | None:
        """Name in words the reasons against a change that ``override`` ignores now; None if there are none."""
        found = [self._lock.words] if self._lock is not None and override.lock else []
        if override.requirements:
            found += [each.words for each in self.requirements() if not each.holds]
        return "; ".join(found) or None

    def recorded_refusal(self, what: str, override: Override, *, recovery: bool = False) -> str | None:
        """The :meth:`refusal`; it, or what ``override`` ignores, is recorded as an incident of ``what``."""
        because = self.refusal(override, recovery=recovery)
        if because is not None:
            self.events.add("forbidden", f"{what}: refused, since {because}")
        elif (ignored := self.overridden(override)) is not None:
            self.events.add("override", f"{what}: carried out although {ignored}")
        return because

    def requirement_check(self, plan: Plan, override: Override, *, recovery: bool) -> Callable[[Sequence[int]], None]:
        """Return the function to call with the steps of ``plan`` that are about to begin.

        Before any that lower a functionality, the requirements are judged once more. Where one does not hold, the
        change goes on if to finish it lowers less than to roll it back; else ChangeForbidden is raised.
        """
        lowering = PlanLowering(plan)

        def require(indices: Sequence[int]) -> None:
            if not self._listeners or not any(map(lowering.lowers, indices)):
                return
            if (because := self.unmet(override, recovery=recovery)) is None:
                return
            finishing, rolling_back = lowering.finishing(indices[0]), lowering.rolling_back(indices[0])
            less = f"to finish lowers {finishing}, to roll back {rolling_back}"
            if not lowering.is_better_finished(indices[0]):
                raise ChangeForbidden(f"{because}; {less}")
            self.events.add("finished_despite", f"the change goes on before step {indices[0] + 1}, {less}: {because}")

        return require

    async def until_recovery(self) -> None:
        """Return when the manager may restart what has crashed."""
        while self.refusal(recovery=True) is not None:
            await self.backend.clock.sleep(ASK_AGAIN)

    async def close(self) -> None:
        """Listen no more, and watch for the end of the lock no more; the next manager does."""
        self._cancel()
        self.follow(())
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- requirements ------------------------------------------------------------------------------------

    def follow(self, requirements: tuple[ChangeRequirement, ...]) -> None:
        """From now on, changes require these. A topic that was listened to for the same goes on."""
        for gone in self._listeners.keys() - set(requirements):
            listener = self._listeners.pop(gone)
            if not isinstance(listener, str):
                listener.close()
        for requirement in requirements:
            if requirement not in self._listeners:
                self._listeners[requirement] = self._listen(requirement)
        if self._listeners and self._watching is None:
            self._watching = self._begin(self._watch())
        elif not self._listeners and self._watching is not None:
            self._watching.cancel()
            self._watching = None

    def _listen(self, requirement: ChangeRequirement) -> TopicListener | str:
        try:
            return self.backend.listen(requirement.topic, requirement.assumption)
        except BackendError as error:
            return str(error)

    def requirements(self) -> list[RequirementStatus]:
        """Every requirement for changes, and whether it holds now."""
        return list(self._judged())

    def _judged(self) -> Iterator[RequirementStatus]:
        for requirement, listener in self._listeners.items():
            heard = HeardMessage(problem=listener) if isinstance(listener, str) else listener.heard()
            because = why_unmet(requirement, heard, self.backend.clock.steady())
            yield RequirementStatus(
                requirement=str(requirement),
                topic=requirement.topic,
                recovery=requirement.recovery,
                holds=because is None,
                because=because,
            )

    async def _watch(self) -> None:
        """Say when a requirement begins or ceases to hold."""
        while True:
            found = self.requirements()
            before = {each.requirement: each for each in self._shown}
            self._shown = found
            for each in found:
                if before.get(each.requirement) != each:
                    self.events.add("requirement", each.words)
            await self.backend.clock.sleep(ASK_AGAIN)

    # -- the lock ----------------------------------------------------------------------------------------

    @property
    def current_lock(self) -> ChangeLock | None:
        """The lock that is in force."""
        return self._lock

    def lock(self, reason: str, by: str, until: float | None, holds_recovery: bool = False) -> ChangeLock:
        """Lock the system at once; a change in progress goes on. Returns the lock.

        Raises ChangeForbidden if it is locked already, or ``until`` (unix s) has passed.
        """
        if self._lock is not None:
            raise ChangeForbidden(f"{self._lock.words}; `midstride unlock` ends that lock")
        if until is not None and until <= self.now():
            raise ChangeForbidden("the lock would have ended already: its end is in the past")
        lock = ChangeLock(reason=reason, by=by, since=self.now(), until=until, holds_recovery=holds_recovery)
        self._take(lock)
        self.store.write_lock(lock)
        besides = "; nothing is restarted or restored either" if holds_recovery else ""
        self.events.add("lock", f"{lock.words}{besides}")
        return lock

    def unlock(self, by: str) -> ChangeLock:
        """End the lock; returns it. Raises ChangeForbidden if the system is not locked."""
        if self._lock is None:
            raise ChangeForbidden("the system is not locked")
        lock = self._lock
        self._end(f"{by} has unlocked the system, which {lock.by} had locked: {lock.reason}")
        return lock

    def restore(self, lock: ChangeLock | None) -> None:
        """Keep the ``lock`` that an earlier manager had, unless it has expired meanwhile."""
        if lock is not None:
            self._take(lock)

    def _take(self, lock: ChangeLock) -> None:
        self._lock = lock
        if lock.until is not None:
            self._expiry = self._begin(self._expire(lock, lock.until))

    async def _expire(self, lock: ChangeLock, until: float) -> None:
        await self.backend.clock.sleep(max(0.0, until - self.now()))
        self._expiry = None
        self._end(f"the lock of {lock.by} has ended, as it said: {lock.reason}")

    def _begin(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _cancel(self) -> None:
        expiry, self._expiry = self._expiry, None
        if expiry is not None:
            expiry.cancel()

    def _end(self, words: str) -> None:
        self._lock = None
        self._cancel()
        self.store.write_lock(None)
        self.events.add("unlock", words)


def why_unmet(requirement: ChangeRequirement, heard: HeardMessage, now: float) -> str | None:
    """The reason why a requirement does not hold ``now`` (steady s), None if it does. An unknown one does not hold."""
    if heard.problem is not None:
        return heard.problem
    if not heard.publishers:
        return "no publisher"
    if heard.at is None:
        return "no message has arrived of the publishers that are there now"
    if requirement.max_age is not None and now - heard.at > requirement.max_age:
        return f"the last message is older than {format_number(requirement.max_age)} s"
    return "; ".join(heard.unmet) or None
