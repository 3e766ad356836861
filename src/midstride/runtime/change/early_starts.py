"""Starts the processes of creations ahead of their steps, so that they load in parallel, as the machine can."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import MidstrideError, StartFailed, Superseded
from midstride.model.action import Create
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.process.pacing import room_for_a_start
from midstride.runtime.records.state_store import StateStore

# After how long a process that could not be started ahead of its step is tried again (s): what was in its way, such as
# an earlier node of its name, may have gone.
START_AGAIN: Final = 1.0


class StartFailedEarly(Exception):
    """A process that was started ahead of its step could not start, or has exited; ``error`` says why."""

    def __init__(self, action: Create, error: MidstrideError) -> None:
        super().__init__(str(error))
        self.action, self.error = action, error


@dataclass(slots=True)
class EarlyStarts:
    """The early starts of the change of ``driver``. What is started is saved, so that the next manager finds it.

    In a partial change, one that fails does not end the step in progress: its own step fails, and is tried twice.
    """

    driver: ActionDriver
    store: StateStore
    _one: asyncio.Lock = field(default_factory=asyncio.Lock)
    _tasks: list[asyncio.Task[None]] = field(default_factory=list)
    _failed: asyncio.Event = field(default_factory=asyncio.Event)
    _failure: StartFailedEarly | None = None

    async def start(self, action: Create) -> None:
        """Start the process of a creation unless it is starting already. Raises StartFailed."""
        try:
            async with self._one:
                await self._start(action)
        except StartFailed:
            if not self.driver.change.partial:
                raise
            await self.driver.backend.clock.sleep(START_AGAIN)
            async with self._one:
                await self._start(action)

    async def _start(self, action: Create) -> bool:
        instance, system = action.instance, self.driver.system
        if instance.name in system.configuration.instances or not await self.driver.start(instance):
            return False
        self.store.write_instance(instance, system.life[instance.name].handle)
        return True

    async def start_before(self, action: Create) -> None:
        """Start before the step of ``action``, in which a failure shows. Raises Superseded."""
        with suppress(StartFailed):
            await self._start_ahead(action)

    async def _start_ahead(self, action: Create) -> None:
        """Start before the step. Raises Superseded: then this manager leaves no process that it has started.

        Before each step its intent is written, which only the manager with the lease can. Here, nothing is.
        """
        async with self._one:
            await self.driver.change.entry.require_lease()
            started = await self._start(action)
            try:
                await self.driver.change.entry.require_lease()
            except Superseded:
                if started:
                    await self.driver.launcher.abandon(action.instance.name)
                raise

    async def at_rest(self) -> None:
        """Wait until no process is just being started ahead of its step."""
        async with self._one:
            pass

    def begin(self, actions: Iterable[Create]) -> None:
        """Start the processes of ``actions`` one after another, and return at once."""
        if some := tuple(actions):
            self._tasks.append(asyncio.ensure_future(self._start_all(some)))

    def check(self) -> None:
        """Raises StartFailedEarly if one of them cannot start, or has exited before it registered."""
        if self._failure is not None:
            raise self._failure

    async def wait(self, creating: asyncio.Future[Any]) -> None:
        """Wait until ``creating`` is done. Raises StartFailedEarly as soon as another one has failed.

        It may be waiting for that one, and would be blamed.
        """
        failing = asyncio.ensure_future(self._failed.wait())
        try:
            await asyncio.wait({creating, failing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            failing.cancel()
        if not creating.done():
            self.check()

    async def stop(self) -> None:
        """Start no further ones, and forget what has failed."""
        async with self._one:  # not between the start of a process and its record
            for task in self._tasks:
                task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()
        self._failed.clear()
        self._failure = None

    async def _start_all(self, actions: Iterable[Create]) -> None:
        launcher, clock, started = self.driver.launcher, self.driver.backend.clock, dict[str, Create]()
        for action in actions:
            await room_for_a_start(clock, launcher.pending.count)
            try:
                try:
                    await self._start_ahead(action)
                except Superseded:
                    raise
                except MidstrideError:
                    if self.driver.change.partial:
                        raise
                    await clock.sleep(START_AGAIN)  # meanwhile its own step may try it, and fail with the reason
                    await self._start_ahead(action)
            except MidstrideError as error:
                if self.driver.change.partial and not isinstance(error, Superseded):
                    continue
                return self._fail(action, error)
            started[action.instance.name] = action
        if not self.driver.change.partial and (exited := await launcher.first_exit(started)) is not None:
            name, failure = exited
            self._fail(started[name], failure)

    def _fail(self, action: Create, error: MidstrideError) -> None:
        if self._failure is None:
            self._failure = StartFailedEarly(action, error)
            self._failed.set()
