"""The manager: the paper's configuration management node.

It joins the platform, brings the system up or recovers a running one, and runs one command at a time; others wait.
Its three parts share its knowledge of the system (:mod:`.running_system`): the change session carries out changes
(:mod:`.change.change_session`), the reconciler handles unexpected events (:mod:`.change.reconciler`), and the state
store keeps what the next manager needs (:mod:`.records.state_store`). The robot does not depend on the manager:
components keep running without it, and the next manager finds them again (docs/protocols/recovery.md).
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Collection, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Literal

from msgspec import UNSET, UnsetType

from midstride.codec.configuration_form import ConfigurationForm
from midstride.codec.parameter import json_values
from midstride.errors import BackendError, ChangeForbidden, ManagerError, MidstrideError
from midstride.model.component import ParameterValue
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification, initial
from midstride.model.wording import counted
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest, require
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.change.change_permission import NO_OVERRIDE, Override
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.change.reconciler import Reconciler
from midstride.runtime.change.runtime_verification import Verifier
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.handover.fences import DEFAULT_WAIT
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import Launcher
from midstride.runtime.process.reached_hosts import out_of_reach, unreached
from midstride.runtime.records.change_history import History, SpecificationVersion
from midstride.runtime.records.change_report import ChangeReport
from midstride.runtime.records.disk import DISK, Disk
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.journal import Journal
from midstride.runtime.records.reports import (
    DeadHost,
    DownReport,
    Event,
    LiveConfiguration,
    Outcome,
    UpReport,
    killed_processes,
)
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.records.status_forms import ChangeLock, ParametersReport, ProgramStatus, Status, Why
from midstride.runtime.restore.bring_up import BringUp
from midstride.runtime.restore.fallback_leases import FallbackLeases
from midstride.runtime.restore.half_done import HALF_DONE
from midstride.runtime.restore.respawner import Respawner
from midstride.runtime.restore.restoring import Restorer
from midstride.runtime.restore.returned_hosts import ReturnedHosts
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.view import status
from midstride.runtime.view.instance_status import parameters
from midstride.runtime.view.program_files import Programs
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.runtime.view.why import Explainer
from midstride.runtime.watch.degradation_report import degradations_in_words, remaining_degradations
from midstride.runtime.watch.discovery_watch import DiscoveryWatch
from midstride.runtime.watch.observed_configuration import observe
from midstride.runtime.watch.silence import SilenceMonitor
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import SetParametersCommand
from midstride.wire.state import ComponentState


class Manager:
    """One running system. Every public coroutine raises MidstrideError kinds only."""

    def __init__(
        self,
        specification: Specification,
        backend: Backend,
        workspace: Workspace,
        directory: Path,
        verifier: Verifier | None = None,
        options: SystemOptions = NO_OPTIONS,
        file: Path | None = None,
        disk: Disk = DISK,
        lock: ChangeLock | None = None,
        package_file: str | None = None,
    ) -> None:
        """``file`` is the one that ``specification`` was read from, and ``directory`` where programs are started.

        ``package_file``: `package://PACKAGE/FILE`, where it is one of a package. ``lock``: that of an earlier manager
        of which no component is left.
        """
        named = None if file is None else str(file)
        self._backend, self._workspace, self._options, self._spares = backend, workspace, options, options.spares
        self._lock_before, self._package_file = lock, package_file
        # What the parts have in common: records, commands, and the way to components.
        clock, self.events = backend.clock, (events := EventLog())
        self._journal = journal = Journal(workspace.journal, backend.name, disk)
        self._store = store = StateStore(workspace.state, partial(events.add, "note"), disk)
        self._commands = commands = CommandQueue(clock, events)
        self._client = client = ComponentClient(
            backend.transport, clock, secrets.token_hex(16), lambda: journal.superseded or store.superseded
        )
        nothing = Configuration(context=specification.context)
        self.system = system = RunningSystem(specification, nothing, client.life, named)
        self._launcher = launcher = Launcher(backend, client, directory, options)
        # What is known of components.
        self._programs = Programs(client, directory, backend.executable)
        self._watch = DiscoveryWatch(backend, client, events, system, commands)
        self._monitor = monitor = SilenceMonitor(
            client.life, clock, events, self._watch.stopped, backend.is_stopped, backend.host_links
        )
        # What changes the system, each part by the one before it.
        self._reconciler = reconciler = Reconciler(system, client, monitor, launcher, events, store, commands)
        self._session = session = ChangeSession(reconciler, backend, journal, verifier or Verifier())
        self._respawner = Respawner(system, clock, events, reconciler, session)
        self._restorer = Restorer(system, client, clock, events, reconciler, session, not options.keep_degraded)
        self._returned = ReturnedHosts(system, clock, events, reconciler, session, backend.host_links)
        self._leases = leases = FallbackLeases(system, client, clock, events, reconciler, backend.host_links)
        self.watched = WatchedSystem(session, self._respawner, self._restorer, leases, options.spares)
        launcher.on_killed = lambda name, seconds, words, unfinished: events.add(
            "killed", words, instance=name, seconds=seconds, unfinished=unfinished
        )
        launcher.on_ending = lambda name, others: events.add("note", f"{name} is ended; with it: {others.in_words}")
        # What each of them learns of the others.
        events.listeners += [journal.note, self._while_watching]
        commands.listeners += [self._watch.look_soon, self._keep_spares]
        reconciler.observers += [self._respawner, self._restorer]
        listening = (launcher, self._programs, reconciler, self._restorer, self._returned, leases)
        client.listeners += [part.on_component_event for part in listening]

    def _while_watching(self, event: Event) -> None:
        """Start the next spare process while a change only watches: the command that comes next finds it ready."""
        if event.kind == "watching":
            self._keep_spares()

    def _keep_spares(self) -> None:
        """A command has ended. Where another one waits, spare processes would compete with it for the processor."""
        if self._commands.is_last:
            self._backend.keep_spares(self._spares, self._client.token)

    @property
    def specification(self) -> Specification:
        return self.system.specification

    @property
    def configuration(self) -> Configuration:
        return self.system.configuration

    @property
    def revision(self) -> int:
        """Incremented with each change of the configuration."""
        return self.system.revision

    # -- starting and stopping ---------------------------------------------------------------------------

    async def up(self) -> UpReport:
        """Recover the components that still run, and bring up the rest of the specification.

        What cannot be started is in the report, and restarted if it has a restart policy. Raises ManagerError if the
        running system has another specification or back end; StepFailed if nothing could be started. With the option
        ``strict``, that is so if one component of a system of which none runs cannot be: the others are terminated.
        """
        if (because := out_of_reach(self._backend, self.specification)) is not None:
            raise ManagerError(because)
        saved = self._store.load()
        if saved is not None:
            self._client.token = saved.token  # by which the components recognize their manager
            self.system.file, self.system.changed_since = saved.file, saved.changed_since
        await self._backend.open(self._reconciler.on_exit)
        await self._session.reach_hosts(self.specification)
        self._session.permission.follow(self.specification.requirements)
        self._watch.start()
        self._session.others.start()
        async with self._reconciler.command(f"up {self.specification.name}"):
            interrupted = await self._journal.take_over()
            if self._journal.damaged is not None:
                self.events.add("note", self._journal.damaged)
            if (middleware := self._backend.middleware()).problem:  # before a start that may fail because of it
                self.events.add("note", middleware.problem)
            if saved is not None:
                self._store.take_over()
            lock = self._lock_before if saved is None else saved.lock
            self._session.permission.restore(lock)
            bring_up = BringUp(self._session, self._restorer, self._options, self._workspace.name)
            absent = set() if saved is None else await bring_up.recover(saved, interrupted)
            self._backend.keep_spares(self._spares, self._client.token)
            try:
                missing: dict[str, str] = {}
                if saved is None or not await bring_up.finish(absent, interrupted):
                    missing = await bring_up.restore_missing(absent, is_new=saved is None)
            except BaseException:
                if saved is None and not self.system.life.handles:
                    self._store.delete()
                raise
            await bring_up.set_back(interrupted)
            if saved is None and lock is not None:
                self._store.write_lock(self._session.permission.current_lock)
            for change in interrupted:
                left = None if saved is None else self.specification
                await self._journal.end_interrupted(change, left, self.configuration.instances)
            missing = self._still_missing(absent) | missing
            missing = {role: self._with_policy(role, because) for role, because in sorted(missing.items())}
            many = counted(len(self.configuration.instances), "component")
            intended = initial(self.specification)
            remaining = remaining_degradations(self.system, Configuration(), intended)
            degraded = f"; degraded: {degradations_in_words(remaining)}" if remaining else ""
            without = f" without {', '.join(missing)}" if missing else ""
            by = f" with {middleware.where}" if middleware.where else ""
            source = f" from {self._package_file}" if self._package_file and saved is None else ""
            self.events.add("up", f"{self.specification.name} is up{without}{source}{by}: {many}{degraded}")
            outcome: Literal["done", "incomplete"] = "incomplete" if missing else "done"
            half_done = [event.words for event in self.events.since() if event.kind == HALF_DONE]
            return UpReport(outcome, sorted(self.configuration.instances), remaining, missing, half_done)

    def _still_missing(self, absent: Collection[str]) -> dict[str, str]:
        """The reason why each role has no instance, but those ``absent``: one may have exited since it was started."""
        return {role: exits[-1].details for role, exits in self.system.crashes.items() if role not in absent}

    def _with_policy(self, role: str, because: str) -> str:
        """The reason why a role has no instance, and that it will be started again, if so."""
        policy = self.specification.nodes[role].respawn
        return because if policy is None else f"{because}\nIt is started again {policy}."

    async def close(self) -> None:
        """Disconnect; the components keep running."""
        await self._watch.close()
        await self._session.others.close()
        await self._respawner.close()
        await self._restorer.close()
        await self._returned.close()
        await self._leases.close()
        await self._session.permission.close()
        await self._reconciler.close()
        await self._programs.close()
        self._client.close()
        self._store.close()
        self._journal.close()
        await self._backend.close()

    async def down(self, id: str | None = None) -> DownReport:
        """Terminate every component and delete the saved state. Raises ManagerError naming those that still run.

        A lock does not prevent it, since a robot can be stopped at any time; the lock ends with the system. ``id`` as
        for :meth:`change`.
        """
        before = self.events.last
        self._restorer.stop()
        self._returned.stop()
        self._respawner.stop()  # also a restart in progress: it is rolled back
        async with self._reconciler.command("down", id):
            self._spares = 0
            instances = self.configuration.instances.items()
            running = {name for name, each in instances if not each.component.once}
            names = sorted({*self.system.life.handles, *running})
            ended = await asyncio.gather(*(self._end(name) for name in names))
            if faults := [fault for fault in ended if fault is not None]:
                self._forget(name for name, fault in zip(names, ended, strict=True) if fault is None)
                raise ManagerError("; ".join([*faults, *self._remedies()]))
            self.system.configuration = Configuration(context=self.specification.context)
            self._store.delete()
            lock = self._session.permission.current_lock
            although = "" if lock is None else f", although {lock.words}; that lock has ended with it"
            self.events.add("down", f"{self.specification.name} is down{although}")
            return DownReport(killed=killed_processes(self.events.since(before)))

    def _forget(self, ended: Iterable[str]) -> None:
        """Take what has ended out of the model, although not all has: no status says that it runs."""
        configuration = self.configuration
        for name in ended:
            self._store.remove_instance(name)
            if name in configuration.instances:
                configuration = configuration.without_instance(name)
        self.system.moved(configuration)

    def _remedies(self) -> Iterator[str]:
        """Yield what to do about each host whose instances could not be ended, as it cannot be reached."""
        left = {handle.host for handle in self.system.life.handles.values()}
        for host in sorted(left & unreached(self._backend).keys()):
            yield (
                f"once host {host} is reached again, run `midstride down` again; if it is switched off or destroyed, "
                f"run `midstride dead {host}` before that"
            )

    async def _end(self, name: str) -> str | None:
        handle = self.system.life[name].handle
        if handle is not None and handle.host:
            await self._backend.try_again([handle.host])
        if not self.system.life[name].is_owned:
            try:
                await self._launcher.release(name)
                result = "it is released, and left running"
            except MidstrideError as error:  # not started here, so it is not killed
                result = f"it is left as it is, and could not be released: {error}"
            self.events.add("note", f"{name} was started elsewhere: {result}")
            return None
        try:
            await self._launcher.end(name, whole=True)
        except MidstrideError as error:
            if handle is not None and self._leases.is_given_up(name, handle.host):
                self.events.add("note", f"{name} was on host {handle.host}, which is dead, and is left")
                return None
            return f"{name}: {error}"
        self.events.add("ended", f"{name} has exited")
        return None

    # -- queries -------------------------------------------------------------------------------------

    async def status(self) -> Status:
        """The live components and their modes, with reasons, as they report them; silent ones are marked."""
        programs = await self._programs.status(self.configuration)
        self._session.others.look()
        return status.status(self.watched, programs, await status.other_endpoints(self.watched))

    async def programs(self) -> list[ProgramStatus]:
        """The files of the programs that run, and which of them have changed on disk since."""
        await self._programs.await_answers()
        return await self._programs.status(self.configuration)

    async def live(self) -> LiveConfiguration:
        """The configuration as its components report it; ``silent`` are those that have reported nothing lately."""
        found, silent = observe(self.configuration, self.system.life)
        return LiveConfiguration(revision=self.revision, silent=silent, configuration=ConfigurationForm.of(found))

    async def peek(self, instance: str) -> ComponentState:
        """The current state of one component, requested from it. Raises CallTimeout or Unreachable."""
        return await self._client.peek(instance)

    async def parameters(self, node: str | None = None) -> list[ParametersReport]:
        """The parameters of a role or an instance, or of all instances, requested from them.

        Raises PlanRefused for an unknown node, ManagerError for one that does not run or answer; of all instances,
        those that do not answer are left out.
        """
        if node is not None:
            instance = self.system.live_instance(node)
            try:
                return [_parameters_report(await self._client.peek(instance))]
            except BackendError as error:
                raise ManagerError(f"the parameters of {instance} are not known: {error}") from None
        live = [name for name in sorted(self.configuration.instances) if self.system.life.responsive(name) is not None]
        found = await asyncio.gather(*(self._client.peek(name) for name in live), return_exceptions=True)
        return [_parameters_report(state) for state in found if isinstance(state, ComponentState)]

    async def why(self, functionality: str) -> Why:
        """The reason why a functionality is in the mode it is in. Raises PlanRefused for an unknown one."""
        return Explainer(self.watched).why(functionality)

    async def plan(self, request: PlanRequest) -> Plan:
        """The plan for ``request`` from the current configuration. Raises PlanRefused."""
        plan, _ = await self._session.planner.plan(request)
        return plan

    async def history(self, latest: int) -> History:
        """The latest changes and incidents, also of earlier managers. Raises ManagerError if they cannot be read."""
        return await self._journal.history(latest)

    async def change_report(self, number: int | None = None) -> ChangeReport:
        """A change of the history with all that was recorded of it; by default the latest. Raises ManagerError."""
        return await self._journal.report(number)

    async def earlier_specification(self, version: int | None = None) -> SpecificationVersion:
        """A version of the specification, by default the one before the latest change of it. Raises ManagerError."""
        return await self._journal.specification(version)

    def log(self, since: int = 0) -> list[Event]:
        """The events after number ``since``."""
        return self.events.since(since)

    def subscribe(self, since: int = 0) -> AsyncIterator[Event]:
        """The events after number ``since``, and each new one as it comes."""
        return self.events.follow(since)

    # -- changing -----------------------------------------------------------------------------------

    async def change(
        self,
        request: PlanRequest,
        *,
        expected: int | None = None,
        verify: bool = False,
        brief: bool = False,
        wait: float = DEFAULT_WAIT,
        id: str | None = None,
        by: str | None = None,
        file: str | None = None,
        override: Override = NO_OVERRIDE,
    ) -> Outcome:
        """Carry out ``request``.

        ``expected`` is the revision that the previewed plan was made for: at any other one the change is refused, since
        its plan may differ. With ``verify``, Alloy verifies the plan first, and the change is refused unless the plan
        holds; the live configuration is verified after each step, and the step fails unless it is valid. If ``brief``,
        the next command does not wait until this one has been measured over 20 periods. An old component that hangs is
        fenced after ``wait`` seconds (docs/protocols/fence.md). The events `waiting` and `command`
        contain ``id``, so that a client can distinguish its own from others. The specification of ``request`` was read
        from ``file``. ``by`` says in the history who asked. While the system is locked, it is
        refused without ``override``.
        """
        async with self._reconciler.command(request.describe(), id):
            outcome = await self._session.change(
                request, expected=expected, verify=verify, brief=brief, by=by, wait=wait, override=override
            )
            if file is not None and request.to is not None and outcome.outcome == "done":
                self.system.file, self.system.changed_since = file, False
                self._store.write_file(file)
            return outcome

    async def set_parameters(
        self,
        node: str,
        values: Mapping[str, ParameterValue],
        override: Override = NO_OVERRIDE,
        by: str | None = None,
        id: str | None = None,
    ) -> ParametersReport:
        """Set parameters of a role or an instance, all of them or none, once the commands before are done.

        They count as set at run time: a replacement keeps them. Raises PlanRefused for an unknown node, ManagerError
        for one that does not run, CommandRefused with the component's reason, ChangeForbidden while the system is
        locked, without ``override``. ``by`` says in the history who asked; ``id`` as for :meth:`change`.
        """
        words = ", ".join(f"{name} = {value!r}" for name, value in values.items())
        async with self._reconciler.command(f"param set {node} {words}", id):
            what = f"param set {node} {words}"
            said = f"{by}: {what}" if by else f"`{what}`"
            if (because := self._session.permission.recorded_refusal(said, override)) is not None:
                self.events.add("parameters", f"refused: {because}", outcome="refused")
                raise ChangeForbidden(because)
            try:
                instance = self.system.live_instance(node)
                await self._client.change(instance, SetParametersCommand(parameters=json_values(values), declared={}))
            except MidstrideError as error:  # it may have been set where there was no answer
                outcome = "failed" if isinstance(error, BackendError) else "refused"
                self.events.add("parameters", f"{outcome}: {error}", outcome=outcome)
                raise
            self.events.add("parameters", f"{words} was set on {instance}")
            state = await self._client.peek(instance)
            self.system.values.report(state)
            self._reconciler.save_values()
            return ParametersReport(instance, [each for each in parameters(state) if each.name in values])

    def lock(self, reason: str, by: str, until: float | None = None, *, holds_recovery: bool = False) -> ChangeLock:
        """Lock the system at once: from now on no command changes it, but :meth:`down`. Returns the lock.

        ``until``: when it ends (unix s). ``holds_recovery``: nor is what has crashed restarted, and what has degraded
        restored, but by commands that override the lock. Raises ChangeForbidden if it is locked already.
        """
        return self._session.permission.lock(reason, by, until, holds_recovery)

    async def declare_dead(self, host: str, by: str) -> DeadHost:
        """Take what runs on ``host``, which cannot be reached, for exited, as ``by`` says: it may be started elsewhere.

        What runs there all the same is ended once the host is reached again. Raises PlanRefused for an unknown host,
        ManagerError for one that is reached, ChangeForbidden while the system is locked.
        """
        words = f"dead {host}"
        async with self._reconciler.command(words):
            require("host", host, self.specification.hosts)
            if host not in unreached(self._backend):
                raise ManagerError(
                    f"host {host} is reached, so it is not dead; `midstride replace NODE --on` moves nodes"
                )
            if (because := self._session.permission.recorded_refusal(f"{by}: `{words}`", NO_OVERRIDE)) is not None:
                raise ChangeForbidden(because)
            roles = self._leases.declare_dead(host, by)
            return DeadHost(host=host, instances=[*roles], nodes=sorted({*roles.values()}))

    def unlock(self, by: str) -> ChangeLock:
        """End the lock, on behalf of ``by``; returns it. Raises ChangeForbidden if there is none."""
        return self._session.permission.unlock(by)


def _parameters_report(state: ComponentState) -> ParametersReport:
    unread: str | UnsetType = UNSET
    if state.unread_parameters:
        unread = f"{state.instance} does not say its parameters: its parameter services do not answer"
    return ParametersReport(state.instance, parameters(state), unread)
