"""The reconciler: what happened by itself, and what has to follow from it.

A crash is an unplanned removal, and a component whose code raised has degraded by itself: the model is brought to what
is true, and exactly the functionalities that `best` of what is left asks for are lowered (docs/semantics.md section 7).
Raising them again is a plan's affair.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any

from midstride.model.component import FunctionalityRef
from midstride.runtime.backend import Exited
from midstride.runtime.component_client import ComponentClient, ComponentEvent, Disconnected, Reported
from midstride.runtime.crash_response import settled
from midstride.runtime.crashes import Crashes
from midstride.runtime.events import EventLog
from midstride.runtime.executor import Executor
from midstride.runtime.launcher import Launcher
from midstride.runtime.observed_configuration import own_degradations, own_degradations_in
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.state_store import StateStore

log = logging.getLogger(__name__)


class Reconciler:
    """``executor`` makes what lowers functionalities.

    While a command is carried out (``busy``), it is the command that reconciles, at its beginning and its end.
    ``turn`` is held while the reconciler works alone.
    """

    def __init__(
        self,
        system: RunningSystem,
        events: EventLog,
        store: StateStore,
        executor: Callable[[], Executor],
        turn: Callable[[], AbstractAsyncContextManager[Any]],
        busy: Callable[[], bool],
    ) -> None:
        self.crashes = Crashes()
        # Functionalities that degraded by themselves since a change last asked.
        self.degraded: set[FunctionalityRef] = set()
        self._system = system
        self._events = events
        self._store = store
        self._executor = executor
        self._turn = turn
        self._busy = busy
        self._client: ComponentClient | None = None
        self._launcher: Launcher | None = None
        self._pending_degradations: set[FunctionalityRef] = set()  # to be lowered, and not to be reached
        self._reconciling = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def connect(self, client: ComponentClient, launcher: Launcher) -> None:
        """From now on these are the components' connections and processes."""
        self._client = client
        self._launcher = launcher

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- what is heard -----------------------------------------------------------------------------

    def on_exit(self, event: Exited) -> None:
        """A process has ended that was not asked to."""
        assert self._launcher is not None
        self._launcher.exited(event)
        if event.instance in self._launcher.handles:
            self._ended(event)

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state, or its connection has ended."""
        assert self._launcher is not None
        match event:
            case Disconnected(instance):
                # Of one that was started by hand nothing else tells; the others have a process.
                if instance in self._system.configuration.instances and instance not in self._launcher.handles:
                    self._ended(Exited(instance, None))
            case Reported(state):
                if not self._busy() and own_degradations_in(self._system.configuration, state):
                    self._reconcile_soon()

    def _ended(self, event: Exited) -> None:
        self.crashes.ended(event)
        status = "" if event.status is None else f" (status {event.status})"
        self._events.add("exited", f"{event.instance} exited unexpectedly{status}", log=event.log_tail)
        if not self._busy():
            self._reconcile_soon()

    # -- what follows ------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def around(self) -> AsyncIterator[None]:
        """Reconcile before and after a command."""
        try:
            await self.reconcile()
            yield
            await self.reconcile()
        finally:
            if self._is_behind():  # since then, or where the command has failed
                self._reconcile_soon()

    def _is_behind(self) -> bool:
        """Whether something has happened that the model does not have yet."""
        assert self._client is not None
        return bool(self.crashes.unsettled or own_degradations(self._system.configuration, self._client, ()))

    def _reconcile_soon(self) -> None:
        task = asyncio.get_running_loop().create_task(self._reconcile_alone())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reconcile_alone(self) -> None:
        async with self._turn():
            try:
                await self.reconcile()
            except Exception as error:  # no caller waits for it: what went wrong is logged here or never
                log.exception("reconciling failed")
                self._events.add("note", f"reconciling failed: internal error: {error!r}")

    async def reconcile_crashes(self) -> None:
        """Reconcile where a component has ended, and wait for a reconciliation under way."""
        if self.crashes.unsettled or self._reconciling.locked():
            await self.reconcile()

    async def reconcile(self) -> None:
        """Bring the model to what is true, and lower what that leaves without what it assumes."""
        async with self._reconciling:
            await self._reconcile()

    async def _reconcile(self) -> None:
        assert self._client is not None
        assert self._launcher is not None
        configuration = self._system.configuration
        gone = self.crashes.settle(configuration)
        for name in gone:
            self._launcher.handles.pop(name, None)
            self._client.disconnect(name)
            self._store.remove_instance(name)
        worse = own_degradations(configuration, self._client, gone)
        if not gone and not worse and not self._pending_degradations:
            return
        because = [f"{name} exited unexpectedly" for name in sorted(gone)]
        for name in {ref.instance for ref in worse}:
            self._client.accept(name)  # at the revision that it reports them at
        for ref, index in sorted(worse.items()):
            words = f"{ref} degraded to {configuration.functionality(ref).modes[index].name} by itself"
            self._events.add("degraded", words, functionality=str(ref))
            because.append(words)
            self.degraded.add(ref)
        after, fallen = settled(configuration, gone, worse, self._pending_degradations)
        self._system.moved(after)
        reason = "; ".join(because) or "its input was lost before it could be degraded"
        self._pending_degradations = await self._executor().lower(fallen, reason)
