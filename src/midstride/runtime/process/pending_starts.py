"""Processes that are coming up: each registers, exits, is stopped, or has had its time."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Iterable
from typing import Any, Final

from midstride.runtime.backend_protocol import Backend, Exited
from midstride.runtime.instance_life import STOPPED
from midstride.wire.frames import Greeting, Registration

# How long a process may take to register (s), including imports of large libraries, if no other registers meanwhile.
REGISTRATION_TIMEOUT: Final = float(os.environ.get("MIDSTRIDE_REGISTRATION_TIMEOUT", "30"))
# On a machine that is busy with the starts of others: how long it may take at most (s).
REGISTRATION_LIMIT: Final = 10 * REGISTRATION_TIMEOUT
# How long a program that ends (`once`) may take, besides what its component states (s): a spawner waits for others.
ONCE_TIMEOUT: Final = 60.0
# How often a process that starts is checked for having been stopped (s).
CHECK_STOPPED: Final = 0.5


class PendingStarts:
    """The processes that have been started on ``backend`` and are awaited, by instance."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._starting: dict[str, asyncio.Future[tuple[Greeting, Registration]]] = {}
        self._exits: dict[str, asyncio.Future[Exited]] = {}
        self._started_at: dict[str, float] = {}  # steady s
        self._startups: dict[str, float] = {}  # how long these take to start besides, as their components state (s)
        self._processes: dict[str, str] = {}
        self._to_end: set[str] = set()  # those whose program is to end
        self._last_registration = -REGISTRATION_TIMEOUT  # steady s

    def __contains__(self, name: object) -> bool:
        return name in self._starting

    def begin(
        self,
        name: str,
        startup: float,
        registering: asyncio.Future[tuple[Greeting, Registration]] | None,
        process: str = "",
    ) -> None:
        """Await a process from now on. ``startup``: how long it takes to start besides, as its component states (s).

        ``registering``: its registration; None where its program is to end, and does not register. ``process``: the
        name of the one that it shares with others, which loads one after another.
        """
        self._processes[name] = process or name
        self._exits[name] = asyncio.get_running_loop().create_future()
        self._started_at[name] = self._backend.clock.steady()
        self._startups[name] = startup
        if registering is None:
            self._to_end.add(name)
            self._starting[name] = asyncio.get_running_loop().create_future()
        else:
            self._starting[name] = registering
            registering.add_done_callback(self._registration_done)

    def forget(self, name: str) -> None:
        self._started_at.pop(name, None)
        self._startups.pop(name, None)
        self._processes.pop(name, None)
        self._to_end.discard(name)
        for waiting in (self._starting.pop(name, None), self._exits.pop(name, None)):
            if waiting is not None:
                waiting.cancel()

    def exited(self, event: Exited) -> bool:
        """Note that a process has exited; return whether it is one that was to end, and has done its work."""
        waiting = self._exits.get(event.instance)
        if waiting is not None and not waiting.done():
            waiting.set_result(event)
        return event.instance in self._to_end and event.status == 0

    def exit_of(self, name: str) -> Exited | None:
        """The exit of a process that is awaited, if that has come."""
        exiting = self._exits.get(name)
        return exiting.result() if exiting is not None and exiting.done() and not exiting.cancelled() else None

    def awaited(self, name: str) -> tuple[asyncio.Future[tuple[Greeting, Registration]], asyncio.Future[Exited]]:
        """The registration of a process and its exit; both are cancelled once it is forgotten."""
        return self._starting[name], self._exits[name]

    def _registration_done(self, registering: asyncio.Future[tuple[Greeting, Registration]]) -> None:
        if not registering.cancelled() and registering.exception() is None:
            self._last_registration = self._backend.clock.steady()

    def count(self) -> int:
        """The number of processes that have been started, are to register, and have neither done so nor exited."""
        registering = ((name, each) for name, each in self._starting.items() if name not in self._to_end)
        waiting = (name for name, each in registering if not (each.done() or self._exits[name].done()))
        return len({self._processes[name] for name in waiting})

    async def first_exit(self, names: Iterable[str]) -> tuple[str, Exited] | None:
        """The first of these processes that exits before it has registered, and how; None if all have registered."""
        exits = {self._exits[name]: name for name in names if name in self._exits}
        while exits:
            done, _ = await asyncio.wait(exits, return_when=asyncio.FIRST_COMPLETED)
            for exit in done:
                name = exits.pop(exit)
                if not exit.cancelled():
                    return name, exit.result()
        return None

    async def decided(self, name: str) -> float | None:
        """Wait until a process that starts has registered or exited, was stopped, or has had its time.

        Returns how long that was (s), None if it has not had it. One that is to end does not register, and has its time
        also while it is stopped.
        """
        begun, startup = self._started_at[name], self._startups[name]
        waits: list[asyncio.Future[Any]] = []
        if name in self._to_end:
            timeout = asyncio.ensure_future(self._until(begun, ONCE_TIMEOUT + startup))
        else:
            timeout = asyncio.ensure_future(self._patience(begun, startup))
            waits.append(asyncio.ensure_future(self._stopped(name)))
        waits.append(timeout)
        first: set[asyncio.Future[Any]] = {self._starting[name], self._exits[name], *waits}
        try:
            await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
            return timeout.result() if timeout.done() and not timeout.cancelled() else None
        finally:
            for each in waits:
                each.cancel()

    async def _until(self, begun: float, seconds: float) -> float:
        """Wait until so many seconds have passed since ``begun``, and return them."""
        await self._backend.clock.sleep(max(0.0, begun + seconds - self._backend.clock.steady()))
        return seconds

    async def first_decided(self, names: Iterable[str], quiet: float | None = None) -> str | None:
        """The first of these processes that has registered or exited, was stopped, or has had its time to register.

        One that was not started counts as well. None after ``quiet`` s in which no process has registered.
        """
        waiting = {}
        for name in names:
            if name not in self._starting:
                return name
            waiting[asyncio.ensure_future(self.decided(name))] = name
        if not waiting:
            return None
        idle = None if quiet is None else asyncio.ensure_future(self._quiet(waiting.values(), quiet))
        first: set[asyncio.Future[Any]] = {*waiting, *(() if idle is None else (idle,))}
        try:
            done, _ = await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
            return next((name for each, name in waiting.items() if each in done), None)
        finally:
            for each in first:
                each.cancel()

    async def _quiet(self, names: Iterable[str], seconds: float) -> None:
        """Return when no process has registered for so long (s), nor one of these has been started."""
        clock, begun = self._backend.clock, max(self._started_at[name] for name in names)
        while (left := max(begun, self._last_registration) + seconds - clock.steady()) > 0:
            await clock.sleep(left)

    async def _stopped(self, name: str) -> None:
        """Return once the process has been stopped for ``STOPPED`` seconds: it is not just slow."""
        clock, since = self._backend.clock, math.inf
        while clock.steady() - since < STOPPED:
            await clock.sleep(CHECK_STOPPED)
            since = min(since, clock.steady()) if self._backend.is_stopped(name) else math.inf

    async def _patience(self, begun: float, startup: float) -> float:
        """Wait as long as a component started at ``begun`` may take to register; returns how long that was (s).

        ``startup``: how long its start takes as it states, which is given to it besides (s).
        """
        clock = self._backend.clock
        while True:
            last = max(begun, self._last_registration)
            remaining = min(last + REGISTRATION_TIMEOUT, begun + REGISTRATION_LIMIT) + startup - clock.steady()
            if remaining <= 0:
                return round(clock.steady() - begun, 1)
            await clock.sleep(remaining)
