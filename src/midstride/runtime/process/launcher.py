"""Starts and terminates components: the process, its registration, its termination."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from immutables import Map

from midstride.errors import (
    BackendError,
    CallTimeout,
    CommandRefused,
    MidstrideError,
    SpecificationError,
    StartFailed,
    Unreachable,
)
from midstride.model import wording
from midstride.model.component import (
    DEFAULT_STOP,
    KILL_AT_ONCE,
    ComponentSpec,
    StopTimes,
)
from midstride.model.configuration import Instance
from midstride.runtime.backend_protocol import Backend, Exited, Handle, OtherNodes, RemainingProcess
from midstride.runtime.instance_life import STOPPED, LatestState, ProcessEvent
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.process.component_client import ComponentClient, ComponentEvent
from midstride.runtime.process.launches import launch_of
from midstride.runtime.process.pending_starts import CHECK_STOPPED, ONCE_TIMEOUT, REGISTRATION_LIMIT, PendingStarts
from midstride.runtime.process.registration import mismatches, unexpected_endpoints
from midstride.runtime.timeouts import within
from midstride.wire.commands import ReleaseCommand, WelcomeCommand
from midstride.wire.frames import Greeting, Registration
from midstride.wire.state import ComponentState, Endpoint, GoalCounts

# How long a component may take to end in order before it is killed (s), unless it asks for longer.
STOP_GRACE: Final = 3.0
# How long a running component may take to accept a connection of a new manager (s).
ADOPT_TIMEOUT: Final = 5.0
# How long a component started by hand may take to leave its modes and topics (s).
RELEASE_TIMEOUT: Final = 5.0


def stop_times(component: ComponentSpec, asked: float = 0.0) -> StopTimes:
    """The times for ending the process of a ``component``.

    One with Midstride's API ends in order on SIGTERM, and says how long that may take (``asked``, s). Any other program
    is ended as ROS's own `launch` does. A relay does that with the program behind it.
    """
    if component.gate is None:
        return StopTimes(0.0, max(STOP_GRACE, asked))
    stop = component.stop_times
    return StopTimes(0.0, stop.longest + max(STOP_GRACE, asked)) if component.gate == "relay" else stop


@dataclass(frozen=True, slots=True)
class LastKnown:
    """The last that was known of an instance when it was ended: its last report, and what it had besides its ports.

    ``endpoints``: as it has named them when it registered; a node without Midstride's API has not.
    """

    latest: LatestState | None
    endpoints: Sequence[Endpoint] = ()


class Launcher:
    """Starts, adopts and terminates the processes of components; what becomes of them is recorded in the client's life.

    The back end's exit events are passed to :meth:`exited`.
    """

    def __init__(
        self, backend: Backend, client: ComponentClient, directory: Path, options: SystemOptions = NO_OPTIONS
    ) -> None:
        self._backend = backend
        self._client = client
        self._directory = directory
        self._options = options
        self.pending = PendingStarts(backend)
        self._components: dict[str, ComponentSpec] = {}  # of the processes that it has started or adopted
        self._roles: dict[str, str] = {}  # of the instances that it has started
        self._asked: dict[str, float] = {}  # how long these take to end, as they have said (s)
        self._unfinished: dict[str, str] = {}  # in which way the `on_stop` of those that end has failed
        self._life = client.life
        # Called with an instance whose end was cut short, the seconds that it had, words, and in which way: False if a
        # process had to be killed, True if it was not killed, and could not finish, as where `on_stop` fails.
        self.on_killed: Callable[[str, float, str, bool], object] | None = None
        # Called with an instance that is about to be ended, and the other nodes that end with it.
        self.on_ending: Callable[[str, OtherNodes], object] | None = None
        # By instance that was ended since this was cleared last: which nodes ended with it.
        self.ended_with: dict[str, OtherNodes] = {}
        # By instance that was ended or released since this was cleared last: what was known of it then.
        self.last_known: dict[str, LastKnown] = {}
        # By instance, what has become of the goals of its process, as that has reported last; it may have exited since.
        self.goals: dict[str, GoalCounts] = {}
        # By instance, that of the first process that has ended since the change began.
        self.ended_goals: dict[str, GoalCounts] = {}

    def exited(self, event: Exited) -> bool:
        """A process has exited: if its registration is awaited, the start fails.

        Returns True if it has done its work, and was to end.
        """
        return self.pending.exited(event)

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state, or it has disconnected."""
        if isinstance(event, ComponentState):
            self._backend.reported(event)
            if event.unfinished is not None:
                self._unfinished[event.instance] = event.unfinished
            self.goals[event.instance] = event.goals or GoalCounts()

    def begin_change(self) -> None:
        """Forget what was known of the instances that have ended before."""
        self.ended_with.clear()
        self.last_known.clear()
        self.ended_goals.clear()
        over = [name for name in self.goals if self.has_ended(name) or self._life[name].is_over]
        for name in over:
            del self.goals[name]

    def has_ended(self, name: str) -> bool:
        """Return whether a process of an instance has exited, or was ended since the change began."""
        return name in self.ended_goals or self._life.is_gone(name) or name in self._life.missing

    def _forget_process(self, name: str) -> str | None:
        """The process of an instance has ended: what it reports next is of another. Returns what it left unfinished."""
        if (goals := self.goals.pop(name, None)) is not None:
            self.ended_goals.setdefault(name, goals)
        return self._unfinished.pop(name, None)

    def disconnected(self, name: str) -> None:
        """The connection of a component that was started by hand has closed."""
        self._backend.disconnected(name)

    async def start(
        self,
        instance: Instance,
        *,
        standby: bool = False,
        start_values: Callable[[Instance], dict[str, Any]] = lambda _: {},
        topics: Mapping[str, str] = Map(),
        predecessor: str = "",
        returns: bool = False,
    ) -> bool:
        """Start the process of ``instance`` and return at once; :meth:`registered` waits for it.

        Returns False if it is already starting. A component without ``run`` is started by hand. ``standby``: another
        instance of its role answers requests. ``start_values``: the values of parameters that it starts with instead of
        the declared ones. ``topics``: those of its ports, which a program without Midstride's API is started with.
        ``predecessor``: the instance of its role that runs until this one is up. ``returns``: a roll-back starts it
        again. Raises StartFailed, or what ``start_values`` raises.
        """
        name = instance.name
        if name in self.pending:
            return False
        set_values = start_values(instance)
        self._forget_process(name)  # it may have exited without being asked to
        registering = None if instance.component.once else asyncio.ensure_future(self._client.registered(name))
        startup = instance.started.startup_seconds or 0.0
        self.pending.begin(name, startup, registering, instance.process)
        if instance.component.run is None:
            self._life.started(name, None)
            return True
        self._components[name] = instance.started
        self._roles[name] = instance.role
        try:
            launch = launch_of(
                instance,
                self._backend.name,
                token=self._client.token,
                directory=self._directory,
                options=self._options,
                set_values=set_values,
                standby=standby,
                topics=topics,
                predecessor=predecessor,
                returns=returns,
            )
            self._life.started(name, await self._backend.start(launch))
        except BaseException:
            self.pending.forget(name)
            raise
        return True

    def takes_spare(self, instance: Instance) -> bool:
        """Return whether the program of ``instance`` can be started in a spare process."""
        try:
            arguments = shlex.split(instance.component.run or "")
        except ValueError:
            return False
        return (
            instance.component.gate is None
            and instance.component.package is None
            and instance.component.prefix is None
            and bool(arguments)
            and self._backend.takes_spare(arguments, self._directory)
        )

    async def first_exit(self, names: Iterable[str]) -> tuple[str, StartFailed] | None:
        """The first of these processes that exits before it has registered, and how; None if all have registered."""
        found = await self.pending.first_exit(names)
        return None if found is None else (found[0], StartFailed(_describe_exit(found[1])))

    async def registered(self, instance: Instance) -> None:
        """Start ``instance`` unless it is starting, wait until it registers, check its declaration, and accept it.

        As long as other components register, it has more time: the machine is busy with them. Raises StartFailed, after
        terminating the process that was started.
        """
        name = instance.name
        await self.start(instance)
        try:
            greeting, registration = await self._registration(instance)
            self._verify(instance, greeting, registration)
            self._asked[name] = (await self._welcome(name)).stopping
            self._life.record(name, ProcessEvent.REGISTERED)
        except (Exception, asyncio.CancelledError) as error:
            itself = self.pending.exit_of(name) is not None  # it is not ended here
            await self.abandon(name)
            if isinstance(error, MidstrideError) and not isinstance(error, StartFailed):
                ended = self._life[name].exit if self._life.has_exited(name) else None
                if ended is not None and (itself or wording.exception_in(ended.log_tail) is not None):
                    hint = maybe_done(instance.component, ended)
                    raise StartFailed(_describe_exit(ended, "before it was accepted", hint)) from error
                raise StartFailed(f"{name} registered but could not be accepted: {error}") from error
            raise
        finally:
            self.pending.forget(name)

    async def completed(self, instance: Instance) -> None:
        """Wait until the program of ``instance``, which has been started, has ended with status 0.

        Raises StartFailed for any other status, and where it takes longer than ``ONCE_TIMEOUT`` and what the component
        states; then it is terminated.
        """
        name, component = instance.name, instance.component
        try:
            _, exiting = self.pending.awaited(name)
            await self.pending.decided(name)
            if not exiting.done():
                limit = ONCE_TIMEOUT + (component.startup_seconds or 0.0)
                raise StartFailed(
                    f"{name} has not ended within {limit:g} s (it was started with `{component.run}`); state how long "
                    "its program takes (`takes 60 s once`), or omit `once` if it keeps running"
                )
            if (ended := exiting.result()).status != 0:
                raise StartFailed(_describe_exit(ended, "with its work not done"))
            self._life.record(name, ProcessEvent.COMPLETED)
        except (Exception, asyncio.CancelledError):
            await self.abandon(name)
            raise
        finally:
            self.pending.forget(name)

    async def _registration(self, instance: Instance) -> tuple[Greeting, Registration]:
        name, run = instance.name, instance.component.run
        registering, exiting = self.pending.awaited(name)
        waited = await self.pending.decided(name)
        if registering.done():
            return registering.result()
        if exiting.done():
            ended = exiting.result()
            raise StartFailed(_describe_exit(ended, hint=maybe_done(instance.component, ended)))
        if waited is None:
            raise StartFailed(f"{name} was stopped (SIGSTOP) before it registered, and not continued for {STOPPED:g} s")
        where = f"was started with `{run}`" if run else "is started elsewhere"
        handle = self._life[name].handle
        log = f" Its log: {handle.log_file}" if handle is not None and handle.log else ""
        raise StartFailed(
            f"{name} did not register within {waited:g} s (it {where}); does its program "
            f"create a Component and call start()? If it needs longer, state `takes {2 * waited:g} s` after "
            f"its `run` command.{log}"
        )

    async def _welcome(self, name: str) -> ComponentState:
        """Accept a component that has registered; returns its state.

        One that does not answer is asked again as long as others are starting: the machine is busy with them. Raises
        MidstrideError.
        """
        clock = self._backend.clock
        deadline = clock.steady() + REGISTRATION_LIMIT
        while True:
            try:
                await self._client.observe(name)
                return await self._client.change(name, WelcomeCommand(manager=str(os.getpid())))
            except CallTimeout:
                if not self.pending.count() or self._backend.is_stopped(name) or clock.steady() >= deadline:
                    raise
            await clock.sleep(CHECK_STOPPED)

    def _verify(self, instance: Instance, greeting: Greeting, registration: Registration) -> None:
        name, component = instance.name, instance.component
        if component.run is not None and greeting.start_token != self._client.token:
            raise StartFailed(f"another node called {name} is running already; end it, or give the node another name")
        try:
            registered = registration.declaration.checked()
        except SpecificationError as error:
            raise StartFailed(f"{name} registered something that is no component: {error}") from None
        faults = mismatches(component, registered)
        extra = unexpected_endpoints(component, {name, instance.role}, registration.endpoints)
        faults += [f"its node has {endpoint}, which component {component.name} does not allow" for endpoint in extra]
        if faults:
            raise StartFailed(f"{name} is not the {component.name} that was declared: " + "; ".join(faults))

    async def abandon(self, name: str) -> BackendError | None:
        """Stop waiting for ``name``, and terminate its process if there is one; returns why that failed."""
        self.pending.forget(name)
        if self._life[name].is_owned:
            try:
                await self.end(name)
            except BackendError as error:
                return error
        else:
            self._life.record(name, ProcessEvent.RELEASED)
        return None

    def redeclared(self, instances: Iterable[Instance]) -> None:
        """A change has ended: these run, with components that may state other times than those they started with."""
        for instance in instances:
            if instance.name in self._components:
                self._components[instance.name] = instance.started

    async def end(self, name: str, *, asked: bool = False, whole: bool = False) -> None:
        """End a component that a manager started. Raises BackendError; then its handle is kept.

        ``asked``: an earlier manager has asked it to end, and it is given the time for that. ``whole``: all that share
        its process are to end.
        """
        component, latest = self._components.get(name), self._life.latest(name)
        # A component that handles a request to a service asks for more time than it did when it was accepted.
        seconds = max(self._asked.get(name, 0.0), 0.0 if latest is None else latest.state.stopping)
        stop = DEFAULT_STOP if component is None else stop_times(component, seconds)
        await self._end(name, replace(stop, asked=stop.longest if asked else 0.0, whole=whole))
        self._life.record(name, ProcessEvent.ENDED)

    async def kill(self, name: str) -> None:
        """Kill a component that does not answer: it counts as one that has exited. Raises as ``end``."""
        await self._end(name, KILL_AT_ONCE)
        self._life.exited(Exited(name, None), ProcessEvent.KILLED)

    def left_on_hosts(self, instances: Container[str]) -> dict[str, Handle]:
        """By role: an instance that could not be ended on another host, and is not among ``instances``.

        One whose lease is over is silent there, and keeps nothing from taking its place.
        """
        life = self._life
        left = [(name, life[name].handle) for name in life.left_on_hosts(instances) if not life[name].silent]
        return {self._roles.get(name, name): handle for name, handle in left if handle is not None}

    async def end_left(self, name: str) -> None:
        """End at once an instance that could not be ended before. Raises BackendError where it cannot be now either."""
        await self._end(name, KILL_AT_ONCE)
        self._life.record(name, ProcessEvent.ENDED)

    async def _end(self, name: str, stop: StopTimes) -> None:
        self._client.forget_revision(name)
        self._note_others(name)
        self._note_last(name)
        handle = self._life[name].handle
        self._life.record(name, ProcessEvent.END_BEGUN)
        try:
            killed = await self._backend.end(name, stop)
        except BaseException:
            self._life.record(name, ProcessEvent.END_FAILED)
            raise
        self._client.disconnect(name)
        self._components.pop(name, None)
        asked, unfinished = self._asked.pop(name, 0.0), self._forget_process(name)
        if unfinished is not None and not killed and self.on_killed is not None:
            self.on_killed(name, asked, f"{name}: {unfinished}", True)
        for process in killed:
            words = killed_in_words(name, None if handle is None else handle.pid, process)
            if self.on_killed is not None:
                self.on_killed(name, process.seconds, words, False)

    def _note_others(self, name: str) -> None:
        """Ask once more which nodes end with it: others may have been loaded into its process a moment ago."""
        try:
            others = self._backend.other_nodes([name]).get(name)
        except BackendError:
            return
        if others is not None:
            self.ended_with[name] = others
            if others.nodes and self.on_ending is not None:
                self.on_ending(name, others)

    def _note_last(self, name: str) -> None:
        if not self._life.has_exited(name):  # then it has ended without this
            self.last_known[name] = LastKnown(self._life.latest(name), self._client.endpoints(name))

    async def release(self, name: str) -> None:
        """Release a component that was started by hand: degraded and unattached, it waits for the next manager.

        Does nothing if it has exited. Raises MidstrideError if it does not answer, or a call of user code does not
        return in time.
        """
        self._note_last(name)
        with contextlib.suppress(Unreachable):
            await self._client.change(name, ReleaseCommand(timeout=RELEASE_TIMEOUT))
        self.leave(name)

    def leave(self, name: str) -> None:
        """Have nothing more to do with a component that was started by hand."""
        self._client.disconnect(name)
        self._life.record(name, ProcessEvent.RELEASED)

    async def adopt(self, handle: Handle, component: ComponentSpec, *, owned: bool = True) -> ComponentState | None:
        """Connect to a ``component`` of an earlier manager. None if it has exited or belongs to another system.

        ``owned``: that manager started it, so this one may terminate it. Raises Unreachable if it runs but does not
        answer.
        """
        if not await self._backend.adopt(handle):
            return None
        self._life.adopted(handle.instance, handle if owned else None)
        self._components[handle.instance] = component
        try:
            async with within(ADOPT_TIMEOUT):
                await self._client.connect(handle.instance)
            state = await self._client.observe(handle.instance)
        except CommandRefused:
            return None
        except (asyncio.TimeoutError, CallTimeout, Unreachable):
            which, remedy, pid = "", "", handle.pid
            if owned:
                which = f" (process {pid}{f' on host {handle.host}' if handle.host else ''})"
                remedy = (
                    f": continue it (`kill -CONT {pid}`) or end it (`kill -9 {pid}`), then run `midstride up` again"
                )
            words = f"{handle.instance} runs{which}, but does not answer on its control socket{remedy}"
            raise Unreachable(words) from None
        self._asked[handle.instance] = state.stopping
        return state

    async def end_if_running(self, handle: Handle) -> bool:
        """End the program of an earlier manager that was to end; whether it still ran. Raises BackendError."""
        if not await self._backend.adopt(handle):
            return False
        self._life.adopted(handle.instance, handle)
        await self.end(handle.instance)
        return True

    async def end_orphans(self, known: Container[str]) -> list[str]:
        """Terminate the system's processes whose instance is not ``known``. Raises BackendError."""
        ended = await self._backend.end_orphans(self._client.token, known, DEFAULT_STOP)
        for name in ended:
            await self._backend.end(name, KILL_AT_ONCE)  # the graph may still show it, and its name may be used again
        return ended


def killed_in_words(name: str, leader: int | None, process: RemainingProcess) -> str:
    """Say that ``process`` of the instance ``name`` had to be killed; ``leader``: the process id of the instance."""
    if process.pid is None:
        what = f"`{process.program}`, behind the relay {name},"
    elif leader is None or process.pid == leader:
        what = name
    else:
        what = f"`{process.program}` (process {process.pid}), which {name} had started,"
    return wording.killed(what, process.seconds)


def maybe_done(component: ComponentSpec, ended: Exited) -> str:
    """Return what to state if a program without Midstride's API has ended with status 0: it may have done its work."""
    if ended.status != 0 or component.gate is None:
        return ""
    return '; if it had done its work then, state it: `run "…" once`'


def _describe_exit(event: Exited, when: str = "before it registered", hint: str = "") -> str:
    how = wording.exited(event.status)
    tail = event.log_tail.strip()
    words = event.because or f"{event.instance} {how} {when}"
    return wording.with_log(f"{words}{hint}", tail) if tail else f"{words} and wrote nothing to its log{hint}"
