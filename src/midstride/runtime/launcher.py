"""Starting and ending components: a process, its announcement, its registration, its end."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
from collections.abc import Container
from pathlib import Path
from typing import Any, Final

from midstride.errors import (
    BackendError,
    CommandRefused,
    MidstrideError,
    SpecificationError,
    StartFailed,
    Unreachable,
)
from midstride.model.configuration import Instance
from midstride.model.document import component_from_document
from midstride.runtime.backend import Backend, Exited, Handle, Launch
from midstride.runtime.component_client import ComponentClient
from midstride.runtime.orphans import end_orphans
from midstride.runtime.registration import mismatches, unexpected_endpoints
from midstride.wire.messages import Announcement

# How long a process may take from its start to its registration (s): imports of large libraries and models included.
REGISTRATION_TIMEOUT: Final = float(os.environ.get("MIDSTRIDE_REGISTRATION_TIMEOUT", "30"))
# How long a component may take to end in order before it is ended by force (s), where it does not ask for longer.
STOP_GRACE: Final = 3.0
# How long one that was started by hand may take to let go of its modes and topics (s).
RELEASE_TIMEOUT: Final = 5.0


class Launcher:
    """Knows which process is which component. Events of the back end are fed to :meth:`heard`."""

    def __init__(self, backend: Backend, link: ComponentClient, token: str, directory: Path) -> None:
        self._backend = backend
        self._link = link
        self._token = token
        self._directory = directory
        self._waiting: dict[str, asyncio.Future[Announcement]] = {}
        self._early: dict[str, Announcement] = {}
        self._graces: dict[str, float] = {}
        self._uuids: dict[str, str] = {}
        self.handles: dict[str, Handle] = {}

    def heard(self, event: Announcement | Exited) -> None:
        """Take note of an announcement or an exit that somebody may be waiting for."""
        waiting = self._waiting.get(event.instance)
        if isinstance(event, Announcement):
            if waiting is not None and not waiting.done():
                waiting.set_result(event)
            elif waiting is None:
                self._early[event.instance] = event
            return
        self._early.pop(event.instance, None)
        if waiting is not None and not waiting.done():
            waiting.set_exception(StartFailed(_told_exit(event)))

    async def start(self, instance: Instance) -> bool:
        """Start the process of ``instance`` and return at once; :meth:`registered` waits for it.

        False where that has been done before. A component without ``run`` is started elsewhere. Raises StartFailed.
        """
        name = instance.name
        if name in self._waiting:
            return False
        waiting: asyncio.Future[Announcement] = asyncio.get_running_loop().create_future()
        self._waiting[name] = waiting
        command = instance.component.run
        if command is None:
            if (early := self._early.pop(name, None)) is not None:
                waiting.set_result(early)
            return True
        try:
            arguments = tuple(shlex.split(command))
            if not arguments:
                raise StartFailed(f"{name}: component {instance.component.name} has an empty `run` command")
            handle = await self._backend.start(
                Launch(
                    instance=name,
                    namespace=instance.role.rpartition("/")[0],
                    arguments=arguments,
                    token=self._token,
                    directory=self._directory,
                    parameters=dict(instance.parameters),
                )
            )
        except ValueError as error:
            self._drop(name)
            raise StartFailed(f"{name}: the `run` command {command!r} cannot be split: {error}") from None
        except BackendError:
            self._drop(name)
            raise
        self.handles[name] = handle
        return True

    async def registered(self, instance: Instance) -> None:
        """Wait until ``instance`` has announced itself, check that it is what was declared, and welcome it.

        Raises StartFailed, and then has ended what it started.
        """
        name = instance.name
        await self.start(instance)
        try:
            announcement = await self._announced(instance)
            self._verify(instance, announcement)
            await self._link.observe(name)
            self._learn(name, await self._link.change(name, "welcome", manager=str(os.getpid())))
        except (Exception, asyncio.CancelledError) as error:
            await self.abandon(name)
            if isinstance(error, MidstrideError) and not isinstance(error, StartFailed):
                raise StartFailed(f"{name} registered but could not be taken in: {error}") from error
            raise
        finally:
            self._drop(name)

    async def _announced(self, instance: Instance) -> Announcement:
        waiting = self._waiting[instance.name]
        patience = asyncio.ensure_future(self._backend.clock.sleep(REGISTRATION_TIMEOUT))
        first: set[asyncio.Future[Any]] = {waiting, patience}
        try:
            await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
            if waiting.done():
                return waiting.result()
        finally:
            patience.cancel()
        where = f"was started with `{instance.component.run}`" if instance.component.run else "is started elsewhere"
        log = self.handles[instance.name].log if instance.name in self.handles else None
        raise StartFailed(
            f"{instance.name} did not register within {REGISTRATION_TIMEOUT:g} s (it {where}); does its program "
            f"create a Component and call start()?" + (f" Its log: {log}" if log else "")
        )

    def _verify(self, instance: Instance, announcement: Announcement) -> None:
        name, component = instance.name, instance.component
        if component.run is not None and announcement.start_token != self._token:
            raise StartFailed(f"another node called {name} is running already; end it, or give the node another name")
        try:
            registered = component_from_document(announcement.declaration)
        except SpecificationError as error:
            raise StartFailed(f"{name} registered something that is no component: {error}") from None
        faults = mismatches(component, registered)
        extra = unexpected_endpoints(component, instance.name, announcement.endpoints)
        faults += [f"its node has {endpoint}, which component {component.name} does not allow" for endpoint in extra]
        if faults:
            raise StartFailed(f"{name} is not the {component.name} that was declared: " + "; ".join(faults))

    def _drop(self, name: str) -> None:
        waiting = self._waiting.pop(name, None)
        if waiting is not None and not waiting.done():
            waiting.cancel()
        elif waiting is not None and not waiting.cancelled():
            waiting.exception()  # seen, so that the loop does not complain of it

    async def abandon(self, name: str) -> None:
        """End what was started for ``name``, if anything was; whatever happens on the way, go on."""
        self._drop(name)
        if name in self.handles:
            with contextlib.suppress(BackendError):
                await self.end(name)

    async def end(self, name: str) -> None:
        """End a component that was started here, or by an earlier manager. Raises BackendError: then it is kept."""
        self._link.forget(name)
        await self._backend.end(name, self._graces.get(name, STOP_GRACE))
        for known in (self._graces, self._uuids, self.handles):
            known.pop(name, None)

    async def release(self, name: str) -> None:
        """Let go of a component that was started by hand: degraded and unattached, it waits for the next manager.

        One that is not there any more needs no letting go. Raises MidstrideError where it does not answer, or its code
        does not return in time.
        """
        with contextlib.suppress(Unreachable):
            await self._link.change(name, "release", timeout=RELEASE_TIMEOUT)
        self._link.forget(name)
        self._uuids.pop(name, None)

    def is_another(self, announcement: Announcement) -> bool:
        """Whether this is from another process than the one of that name that was taken in, which is gone. Said once.

        Of a component that was started by hand nothing else tells.
        """
        if self._uuids.get(announcement.instance, announcement.uuid) == announcement.uuid:
            return False
        del self._uuids[announcement.instance]
        return True

    async def adopt(self, handle: Handle, *, own: bool = True) -> dict[str, Any] | None:
        """Find a component of an earlier manager again: its state, or None where it is gone or not ours.

        ``own``: it was started by that manager, so that it is also this one's to end.
        """
        if not await self._backend.adopt(handle):
            return None
        if own:
            self.handles[handle.instance] = handle
        try:
            state = await self._link.observe(handle.instance)
        except CommandRefused:
            return None
        self._learn(handle.instance, state)
        return state

    async def end_strays(self, known: Container[str]) -> list[str]:
        """End what an earlier manager started and could not record: all but the ``known``. Raises BackendError."""
        return await end_orphans(self._token, known, STOP_GRACE)

    def _learn(self, name: str, state: dict[str, Any]) -> None:
        """Which process it is, and how long its author wants it to have for its end (``on_stop``)."""
        self._uuids[name] = str(state["uuid"])
        self._graces[name] = max(STOP_GRACE, float(state.get("stopping", 0.0)))


def _told_exit(event: Exited) -> str:
    if event.status is None:
        how = "ended"
    elif event.status < 0:
        how = f"was killed by signal {-event.status}"
    else:
        how = f"exited with status {event.status}"
    tail = event.log_tail.strip()
    return f"{event.instance} {how} before it registered" + (f":\n{tail}" if tail else " and wrote nothing to its log")
