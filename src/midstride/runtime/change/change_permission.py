"""Whether a change of the running system may happen now (docs/how-to/lock.md).

A person may lock the system, for a reason: then no command changes it but `down`. What the manager does without a
command, restarting what has crashed and restoring what has degraded, goes on unless the lock holds that back as well.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import ChangeForbidden
from midstride.runtime.manager_clock import Clock
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.records.status_forms import ChangeLock

# How often a restart that is held back looks whether it may happen (s).
ASK_AGAIN: Final = 0.5
_UNLOCK: Final = "`midstride unlock` ends that, `--despite-lock` changes the system all the same"


@dataclass(frozen=True, slots=True)
class Override:
    """What a command overrides deliberately, so that it changes the system all the same."""

    lock: bool = False


NO_OVERRIDE: Final = Override()


@dataclass(slots=True)
class ChangePermission:
    """Decides whether changes may happen, and keeps the lock for the next manager. ``now`` gives the UNIX time."""

    clock: Clock
    events: EventLog
    store: StateStore
    now: Callable[[], float] = time.time
    _lock: ChangeLock | None = None
    _expiry: asyncio.Task[None] | None = None
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)

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

    def refusal(self, override: Override = NO_OVERRIDE, *, recovery: bool = False) -> str | None:
        """Why a change must not begin now, None if it may. ``recovery``: the manager makes it without a command."""
        lock = self._lock
        if lock is None or override.lock or (recovery and not lock.holds_recovery):
            return None
        return f"{lock.words}; {_UNLOCK}"

    def overridden(self, override: Override) -> str | None:
        """What a change with ``override`` ignores now, in words; None if nothing."""
        return None if self._lock is None or not override.lock else self._lock.words

    async def until_recovery(self) -> None:
        """Return when the manager may restart what has crashed."""
        while self.refusal(recovery=True) is not None:
            await self.clock.sleep(ASK_AGAIN)

    async def close(self) -> None:
        """Watch for the end of the lock no more; the next manager does."""
        self._cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _take(self, lock: ChangeLock) -> None:
        self._lock = lock
        if lock.until is not None:
            self._expiry = asyncio.get_running_loop().create_task(self._expire(lock, lock.until))
            self._tasks.add(self._expiry)
            self._expiry.add_done_callback(self._tasks.discard)

    async def _expire(self, lock: ChangeLock, until: float) -> None:
        await self.clock.sleep(max(0.0, until - self.now()))
        self._expiry = None
        self._end(f"the lock of {lock.by} has ended, as it said: {lock.reason}")

    def _cancel(self) -> None:
        expiry, self._expiry = self._expiry, None
        if expiry is not None:
            expiry.cancel()

    def _end(self, words: str) -> None:
        self._lock = None
        self._cancel()
        self.store.write_lock(None)
        self.events.add("unlock", words)
