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
from midstride.runtime.backend import Backend, Exited, Handle, Launch
from midstride.runtime.component_client import ComponentClient
from midstride.runtime.orphans import end_orphans
from midstride.runtime.registration import mismatches, unexpected_endpoints
from midstride.runtime.timeouts import within
from midstride.wire.commands import ReleaseCommand, WelcomeCommand
from midstride.wire.frames import Greeting, Registration
from midstride.wire.state import ComponentState

# How long a process may take from its start to its registration (s): imports of large libraries and models included.
REGISTRATION_TIMEOUT: Final = float(os.environ.get("MIDSTRIDE_REGISTRATION_TIMEOUT", "30"))
# How long a component may take to end in order before it is ended by force (s), where it does not ask for longer.
STOP_GRACE: Final = 3.0
# How long a running component may take to be found on its control socket again (s).
ADOPT_TIMEOUT: Final = 5.0
# How long one that was started by hand may take to leave its modes and topics (s).
RELEASE_TIMEOUT: Final = 5.0


class Launcher:
    """Knows which process is which component. Exits that the back end reports are fed to :meth:`exited`."""

    def __init__(self, backend: Backend, client: ComponentClient, token: str, directory: Path) -> None:
        self._backend = backend
        self._client = client
        self._token = token
        self._directory = directory
        self._starting: dict[str, asyncio.Future[tuple[Greeting, Registration]]] = {}
        self._exits: dict[str, asyncio.Future[Exited]] = {}
        self._graces: dict[str, float] = {}
        self.handles: dict[str, Handle] = {}

    def exited(self, event: Exited) -> None:
        """Take note of an exit, which fails the start that waits for its registration."""
        waiting = self._exits.get(event.instance)
        if waiting is not None and not waiting.done():
            waiting.set_result(event)

    async def start(self, instance: Instance) -> bool:
        """Start the process of ``instance`` and return at once; :meth:`registered` waits for it.

        False where that has been done before. A component without ``run`` is started elsewhere. Raises StartFailed.
        """
        name = instance.name
        if name in self._starting:
            return False
        self._exits[name] = asyncio.get_running_loop().create_future()
        self._starting[name] = asyncio.ensure_future(self._client.registered(name))
        command = instance.component.run
        if command is None:
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
            greeting, registration = await self._registration(instance)
            self._verify(instance, greeting, registration)
            await self._client.observe(name)
            self._learn(await self._client.change(name, WelcomeCommand(manager=str(os.getpid()))))
        except (Exception, asyncio.CancelledError) as error:
            await self.abandon(name)
            if isinstance(error, MidstrideError) and not isinstance(error, StartFailed):
                raise StartFailed(f"{name} registered but could not be accepted: {error}") from error
            raise
        finally:
            self._drop(name)

    async def _registration(self, instance: Instance) -> tuple[Greeting, Registration]:
        name = instance.name
        registering, exiting = self._starting[name], self._exits[name]
        patience = asyncio.ensure_future(self._backend.clock.sleep(REGISTRATION_TIMEOUT))
        first: set[asyncio.Future[Any]] = {registering, exiting, patience}
        try:
            await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
        finally:
            patience.cancel()
        if registering.done():
            return registering.result()
        if exiting.done():
            raise StartFailed(_describe_exit(exiting.result()))
        where = f"was started with `{instance.component.run}`" if instance.component.run else "is started elsewhere"
        log = self.handles[name].log if name in self.handles else None
        raise StartFailed(
            f"{name} did not register within {REGISTRATION_TIMEOUT:g} s (it {where}); does its program "
            f"create a Component and call start()?" + (f" Its log: {log}" if log else "")
        )

    def _verify(self, instance: Instance, greeting: Greeting, registration: Registration) -> None:
        name, component = instance.name, instance.component
        if component.run is not None and greeting.start_token != self._token:
            raise StartFailed(f"another node called {name} is running already; end it, or give the node another name")
        try:
            registered = registration.declaration.checked()
        except SpecificationError as error:
            raise StartFailed(f"{name} registered something that is no component: {error}") from None
        faults = mismatches(component, registered)
        extra = unexpected_endpoints(component, instance.name, registration.endpoints)
        faults += [f"its node has {endpoint}, which component {component.name} does not allow" for endpoint in extra]
        if faults:
            raise StartFailed(f"{name} is not the {component.name} that was declared: " + "; ".join(faults))

    def _drop(self, name: str) -> None:
        for waiting in (self._starting.pop(name, None), self._exits.pop(name, None)):
            if waiting is not None:
                waiting.cancel()

    async def abandon(self, name: str) -> None:
        """End what was started for ``name``, if anything was; whatever happens on the way, go on."""
        self._drop(name)
        if name in self.handles:
            with contextlib.suppress(BackendError):
                await self.end(name)

    async def end(self, name: str) -> None:
        """End a component that was started here, or by an earlier manager. Raises BackendError: then it is kept."""
        self._client.forget(name)
        await self._backend.end(name, self._graces.get(name, STOP_GRACE))
        self._client.disconnect(name)
        for known in (self._graces, self.handles):
            known.pop(name, None)

    async def release(self, name: str) -> None:
        """Let go of a component that was started by hand: degraded and unattached, it waits for the next manager.

        One that is not there any more needs no letting go. Raises MidstrideError where it does not answer, or its code
        does not return in time.
        """
        with contextlib.suppress(Unreachable):
            await self._client.change(name, ReleaseCommand(timeout=RELEASE_TIMEOUT))
        self._client.disconnect(name)

    async def adopt(self, handle: Handle, *, own: bool = True) -> ComponentState | None:
        """Find a component of an earlier manager again: its state, or None where it is gone or not ours.

        ``own``: that manager started it, so that this one may end it. Raises Unreachable where it runs and does not
        answer.
        """
        if not await self._backend.adopt(handle):
            return None
        if own:
            self.handles[handle.instance] = handle
        try:
            async with within(ADOPT_TIMEOUT):
                await self._client.connect(handle.instance)
        except asyncio.TimeoutError:
            if not own:
                return None
            raise Unreachable(
                f"{handle.instance} runs (process {handle.pid}), but does not answer on its control socket"
            ) from None
        try:
            state = await self._client.observe(handle.instance)
        except CommandRefused:
            return None
        self._learn(state)
        return state

    async def end_orphans(self, known: Container[str]) -> list[str]:
        """End what an earlier manager started and could not record: all but the ``known``. Raises BackendError."""
        return await end_orphans(self._token, known, STOP_GRACE)

    def _learn(self, state: ComponentState) -> None:
        """How long its author wants it to have for its end (``on_stop``)."""
        self._graces[state.instance] = max(STOP_GRACE, state.stopping)


def _describe_exit(event: Exited) -> str:
    if event.status is None:
        how = "ended"
    elif event.status < 0:
        how = f"was killed by signal {-event.status}"
    else:
        how = f"exited with status {event.status}"
    tail = event.log_tail.strip()
    return f"{event.instance} {how} before it registered" + (f":\n{tail}" if tail else " and wrote nothing to its log")
