"""The life of a manager: bringing the system up, serving it, taking it down or leaving it.

The API answers while the system is being brought up, so that a client can follow. A manager that could not bring its
system up exits once a client has read why.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

from midstride.errors import ManagerError, MidstrideError, internal_error
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import DownReport, UpReport
from midstride.runtime.records.status_forms import Phase
from midstride.runtime.timeouts import within

log = logging.getLogger(__name__)

T = TypeVar("T")

# How long a manager that has failed waits for a client to read why (s).
LINGER: Final = 5.0
_INTERRUPTED: Final = "the operation was interrupted and rolled back"
_TERMINATED: Final = "the manager was terminated"
_TAKEN_DOWN: Final = "`down` stops the system"
_ROLLING_BACK: Final = (
    "the manager was terminated and is still rolling back; `midstride up` with the system's file finds what is running"
)
_STILL_ENDING: Final = "the manager was terminated and still ends the components; what it cannot end keeps running"
_NO_MORE: Final = "the manager is shutting down; nothing was changed"


class Lifecycle:
    """Owns the tasks that outlive the request that began them. Used on the manager's loop alone.

    ``on_phase`` is called when ``phase`` has changed. ``up_ended`` is set once it is known whether the system came up,
    ``ended`` once the manager shall exit. ``alone``: no client waits to read why the system did not come up.
    """

    def __init__(self, manager: Manager, *, alone: bool = False) -> None:
        self.manager = manager
        self.phase: Phase = "starting"
        self.on_phase: Callable[[], object] = lambda: None
        self.up_ended = asyncio.Event()
        self.ended = asyncio.Event()
        self.failure: MidstrideError | None = None
        self._failure_read = asyncio.Event()
        if alone:
            self._failure_read.set()
        self._bringing_up: asyncio.Task[None] | None = None
        self._taking_down: asyncio.Event | None = None  # set once it has ended
        self._report: UpReport | None = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self._breakable: set[asyncio.Task[Any]] = set()

    def bring_up(self) -> asyncio.Task[None]:
        """Bring the system up in a task, which raises nothing; afterwards ``phase`` is ``up`` or ``failed``."""
        self._bringing_up = asyncio.ensure_future(self._bring_up())
        return self._bringing_up

    async def _bring_up(self) -> None:
        try:
            self._report = await self.manager.up()
        except MidstrideError as error:
            self.failure = error
        except asyncio.CancelledError:
            self.failure = ManagerError(f"the system is not up: {self._why_interrupted}")
        except Exception as error:  # a fault of ours must still end in an answer
            log.exception("bringing the system up failed")
            self.failure = ManagerError(f"bringing the system up failed: {internal_error(error)}")
        self.phase = "up" if self.failure is None else "failed"
        if self.failure is not None:
            self.manager.events.add("up_failed", str(self.failure))
        self.on_phase()
        self.up_ended.set()

    async def outcome_of_up(self) -> UpReport:
        """The result of bringing up, once it is known. Raises the MidstrideError it failed with."""
        await self.up_ended.wait()
        if self.failure is not None:
            self._failure_read.set()
            raise self.failure
        assert self._report is not None
        return self._report

    async def carry_out(self, work: Coroutine[Any, Any, T], *, breakable: bool = True) -> T:
        """Await ``work`` even if the client that requested it disconnects.

        ``breakable`` work is interrupted when the manager is terminated, and raises ManagerError then. Once the manager
        shall exit, none is begun: nothing would interrupt it.
        """
        if self.ended.is_set():
            work.close()
            raise ManagerError("the system is down" if self.phase == "down" else _NO_MORE)
        task = asyncio.ensure_future(work)
        for tasks in (self._tasks, self._breakable) if breakable else (self._tasks,):
            tasks.add(task)
            task.add_done_callback(tasks.discard)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task.cancelled():
                raise ManagerError(self._why_interrupted) from None
            if self.ended.is_set():  # the server closed before the work was complete
                raise ManagerError(_ROLLING_BACK if breakable else _STILL_ENDING) from None
            raise

    @property
    def ends(self) -> bool:
        """Return whether `down` stops the system, or has stopped it."""
        return self._taking_down is not None

    @property
    def _why_interrupted(self) -> str:
        return f"{_TERMINATED if self._taking_down is None else _TAKEN_DOWN}; {_INTERRUPTED}"

    def _interrupt(self) -> None:
        """Interrupt every change, and the start of the system; each is rolled back in its own task."""
        for task in [*self._breakable, *([] if self._bringing_up is None else [self._bringing_up])]:
            task.cancel()

    async def interrupt(self) -> None:
        """Interrupt every change and the start, and wait for their roll-back, while components can be reached."""
        self._interrupt()
        bringing_up = [] if self._bringing_up is None else [self._bringing_up]
        await asyncio.gather(*bringing_up, *self._tasks, return_exceptions=True)

    def require_up(self) -> None:
        """Raises ManagerError while there is no running system to change."""
        if self.phase == "starting":
            raise ManagerError("the system is still being brought up; ask again when it is up")
        if self.phase == "failed":
            raise ManagerError(f"the system could not be brought up: {self.failure}")
        if self.phase == "down":
            raise ManagerError("the system is down")

    async def take_down(self, id: str | None = None) -> DownReport:
        """Stop the system and then the manager. Raises ManagerError if a component would not exit.

        What the manager is doing is interrupted first: the start of the system, or a change, may wait for long.
        """
        self._taking_down = ended = asyncio.Event()
        self._interrupt()
        try:
            report = await self.manager.down(id)
        except BaseException:
            self._taking_down = None
            raise
        finally:
            ended.set()
        self.phase = "down"
        self.on_phase()
        self.ended.set()
        return report

    async def until_over(self) -> None:
        """Wait until the system is down, the manager shall leave it, or a client has read why it did not come up."""
        ended, up_ended = (asyncio.ensure_future(event.wait()) for event in (self.ended, self.up_ended))
        await asyncio.wait({ended, up_ended}, return_when=asyncio.FIRST_COMPLETED)
        up_ended.cancel()
        if (down := self._taking_down) is not None:  # the start was interrupted for it
            await down.wait()
        if self.phase != "failed":
            await ended
        elif down is None:
            with contextlib.suppress(asyncio.TimeoutError):
                async with within(LINGER):
                    await self._failure_read.wait()
        ended.cancel()
