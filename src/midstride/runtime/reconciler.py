"""The reconciler: updates the model after crashes and unexpected degradations, and degrades dependent functionalities.

A crash is an unplanned removal; a component degrades by itself when its code raises. The rules are in
:mod:`.crash_response`. Upgrades are left to plans (docs/semantics.md section 7).
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
from midstride.runtime.crash_response import respond
from midstride.runtime.crashes import Crashes
from midstride.runtime.events import EventLog
from midstride.runtime.executor import Executor
from midstride.runtime.launcher import Launcher
from midstride.runtime.observed_configuration import own_degradations, own_degradations_in
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.state_store import StateStore

log = logging.getLogger(__name__)


class Reconciler:
    """Handles the events of a back end and of components.

    While a command is in progress (``busy``), the command reconciles at its start and its end; otherwise the reconciler
    does so in the background, holding ``lock``. ``executor`` makes the executor that degrades functionalities.
    """

    def __init__(
        self,
        system: RunningSystem,
        events: EventLog,
        store: StateStore,
        executor: Callable[[], Executor],
        lock: Callable[[], AbstractAsyncContextManager[Any]],
        busy: Callable[[], bool],
    ) -> None:
        self.crashes = Crashes()
        # Functionalities that degraded unexpectedly since the last change began.
        self.degraded: set[FunctionalityRef] = set()
        self._system = system
        self._events = events
        self._store = store
        self._executor = executor
        self._lock = lock
        self._busy = busy
        self._client: ComponentClient | None = None
        self._launcher: Launcher | None = None
        self._pending_degradations: set[FunctionalityRef] = set()  # could not be degraded yet
        self._reconciling = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def connect(self, client: ComponentClient, launcher: Launcher) -> None:
        """Use these connections and processes from now on."""
        self._client = client
        self._launcher = launcher

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- events ------------------------------------------------------------------------------------

    def on_exit(self, event: Exited) -> None:
        """A process has exited without being asked to."""
        assert self._launcher is not None
        self._launcher.exited(event)
        if event.instance in self._launcher.handles:
            self._record_exit(event)

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state, or its connection has closed."""
        assert self._launcher is not None
        match event:
            case Disconnected(instance):
                # The only sign of exit for a component started by hand; for others the back end reports it.
                if instance in self._system.configuration.instances and instance not in self._launcher.handles:
                    self._launcher.disconnected(instance)
                    self._record_exit(Exited(instance, None))
            case Reported(state):
                if not self._busy() and own_degradations_in(self._system.configuration, state):
                    self._reconcile_soon()

    def _record_exit(self, event: Exited) -> None:
        self.crashes.record(event)
        status = "" if event.status is None else f" (status {event.status})"
        self._events.add("exited", f"{event.instance} exited unexpectedly{status}", log=event.log_tail)
        if not self._busy():
            self._reconcile_soon()

    # -- reconciling -------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def around(self) -> AsyncIterator[None]:
        """Reconcile before and after a command."""
        try:
            await self.reconcile()
            yield
            await self.reconcile()
        finally:
            if self._is_behind():  # something happened after that, or the command failed
                self._reconcile_soon()

    def _is_behind(self) -> bool:
        """Whether the model lacks a crash or a degradation."""
        assert self._client is not None
        return bool(self.crashes.unreconciled or own_degradations(self._system.configuration, self._client, ()))

    def _reconcile_soon(self) -> None:
        task = asyncio.get_running_loop().create_task(self._reconcile_in_background())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reconcile_in_background(self) -> None:
        async with self._lock():
            try:
                await self.reconcile()
            except Exception as error:  # nothing awaits this task, so errors are logged here
                log.exception("reconciling failed")
                self._events.add("note", f"reconciling failed: internal error: {error!r}")

    async def reconcile_crashes(self) -> None:
        """Reconcile if a component has crashed, and wait for a reconciliation in progress."""
        if self.crashes.unreconciled or self._reconciling.locked():
            await self.reconcile()

    async def reconcile(self) -> None:
        """Update the model to the actual state, and degrade functionalities whose assumptions no longer hold."""
        async with self._reconciling:
            await self._reconcile()

    async def _reconcile(self) -> None:
        assert self._client is not None
        assert self._launcher is not None
        configuration = self._system.configuration
        crashed = self.crashes.take_unreconciled(configuration)
        for name in crashed:
            self._launcher.handles.pop(name, None)
            self._client.disconnect(name)
            self._store.remove_instance(name)
        degraded = own_degradations(configuration, self._client, crashed)
        if not crashed and not degraded and not self._pending_degradations:
            return
        because = [f"{name} exited unexpectedly" for name in sorted(crashed)]
        for name in {ref.instance for ref in degraded}:
            self._client.accept(name)
        for ref, index in sorted(degraded.items()):
            words = f"{ref} degraded to {configuration.functionality(ref).modes[index].name} by itself"
            self._events.add("degraded", words, functionality=str(ref))
            because.append(words)
            self.degraded.add(ref)
        after, to_lower = respond(configuration, crashed, degraded, self._pending_degradations)
        self._system.moved(after)
        reason = "; ".join(because) or "its input was lost before it could be degraded"
        self._pending_degradations = await self._executor().lower(to_lower, reason)
