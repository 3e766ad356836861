"""One command at a time; the others wait for it, in order of arrival."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Any

from midstride.runtime.change.change_phases import ChangePhase
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.manager_clock import Clock
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.status_forms import RunningCommand


@dataclass(slots=True)
class CommandQueue:
    """Decides which command may run; each ``listener`` is called when one has ended.

    ``current`` is the command in progress, in words, and ``change`` the change that it carries out, if any.
    ``another_waits`` is set while the next command waits.
    """

    clock: Clock
    events: EventLog
    listeners: list[Callable[[], object]] = field(default_factory=list)
    current: str | None = None
    change: RunningChange | None = None
    another_waits: asyncio.Event = field(default_factory=asyncio.Event)
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)
    _since: float = 0.0  # when the current one started (steady s)
    _waiting: int = 0  # how many wait for it

    @property
    def is_changing(self) -> bool:
        """True while a command changes the system. One that only measures does not prevent reconciling."""
        return self.current is not None and not self.is_measuring

    @property
    def is_measuring(self) -> bool:
        """True if the command in progress has changed all it is to change, and only the measurement is left."""
        return self.change is not None and self.change.phase is ChangePhase.MEASURING

    @property
    def running(self) -> RunningCommand | None:
        """The command in progress, and for how long it has run (s)."""
        if self.current is None:
            return None
        return RunningCommand(self.current, round(self.clock.steady() - self._since, 3))

    @contextlib.asynccontextmanager
    async def run(self, words: str, id: str | None = None) -> AsyncIterator[None]:
        """Wait until this command may run, and run it; an event says which command it waits for."""
        self._waiting += 1
        if self.current is not None:
            self.events.add("waiting", f"`{words}` waits for `{self.current}`", command=words, id=id)
            self.another_waits.set()
        try:
            await self.lock.acquire()
        finally:
            self._waiting -= 1
            if not self._waiting:
                self.another_waits.clear()
        try:
            self.current, self._since = words, self.clock.steady()
            self.events.add("command", words, id=id)
            yield
        finally:
            self.current = None
            for listener in self.listeners:
                listener()
            self.lock.release()

    @property
    def is_last(self) -> bool:
        """True if no command waits."""
        return not self._waiting

    def between(self) -> AbstractAsyncContextManager[Any]:
        """Wait until no command is changing the system, and keep the next one from beginning."""
        return contextlib.nullcontext() if self.is_measuring else self.lock
