"""The back end of a system on several hosts: that of the manager's own host, and one link to each other one.

Each component runs on one host; what is asked about it goes to the back end of that host, and what is asked about the
graph to the manager's own, whose node sees the graph of all. The control connection of a component on another host
goes through the link of the host, so that to the manager it is an address like any other. To its peers on the same
host it is the path of its socket there.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Container, Coroutine, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from midstride.errors import BackendError, CallTimeout, EndUnknown, StartFailed, Unreachable
from midstride.model.component import StopTimes
from midstride.model.contract import Predicate
from midstride.model.hosts import HostSpec
from midstride.runtime.backend_protocol import (
    Backend,
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    HostLinkState,
    Launch,
    OtherNodes,
    RemainingProcess,
    TopicListener,
)
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts.call_forms import HandleForm, LaunchForm, RemainingForm, StopTimesForm
from midstride.runtime.hosts.host_check import faults_of
from midstride.runtime.hosts.host_frames import HOST_PROTOCOL
from midstride.runtime.hosts.host_link import HostLink
from midstride.runtime.hosts.host_order import LONGEST_SOCKET, SHARED_VARIABLES, HostOrder
from midstride.runtime.hosts.ssh_connection import SshConnection
from midstride.runtime.records.status_forms import Middleware
from midstride.runtime.workspace import Workspace
from midstride.wire.clock_offset import SAME_CLOCK, ClockOffset
from midstride.wire.other_hosts import OtherHostAddress
from midstride.wire.state import ComponentState
from midstride.wire.transport import Connection, CutLock, Serve, StopListening, Transport

log = logging.getLogger(__name__)

# How long a start may take on another host, until the process is there, and the end of one besides its times (s).
START_SECONDS: Final = 60.0
END_SECONDS: Final = 40.0
# The room in a socket's path for the name of a host, a process, and what OpenSSH appends as it makes one (bytes).
_LONGEST_NAME: Final = 61
# A path that OpenSSH takes as it is.
_PLAIN: Final = re.compile(r"[A-Za-z0-9_./@+=,-]+")


class HostsTransport:
    """Implements :class:`midstride.wire.transport.Transport`: ``own`` for this host, links for the others."""

    def __init__(self, own: Transport) -> None:
        self._own = own
        self.link_of: Callable[[str], HostLink | None] = lambda _: None
        self._remote: dict[str, str] = {}  # by address: the instance

    def address(self, instance: str, seen_from: str | None = None) -> str:
        link = self.link_of(instance)
        if seen_from is not None and (other := self.link_of(seen_from)) is not link:
            if other is None and link is not None:
                return str(OtherHostAddress(link.socket, instance))
            if other is not None and other.report is not None:
                return str(OtherHostAddress(Path(other.report.socket), instance, elsewhere=True))
        if link is None:
            return self._own.address(instance)
        folder = "" if link.report is None else link.report.components
        address = f"unix:{folder}/{quote(instance.strip('/'), safe='')}.sock"
        self._remote[address] = instance
        return address

    async def connect(self, address: str) -> Connection:
        instance = self._remote.get(address)
        link = None if instance is None else self.link_of(instance)
        if instance is None or link is None:
            return await self._own.connect(address)
        return await link.connect(instance)

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        return await self._own.listen(instance, serve)

    def cut_lock(self, cut: str) -> CutLock:
        return self._own.cut_lock(cut)

    def present(self) -> dict[str, str]:
        return self._own.present()


def socket_folder(workspace: Workspace) -> Path:
    """The folder ``hosts`` of the sockets of a system's links, which only its user can open.

    OpenSSH takes no longer paths than the kernel, extends that of its own socket, and gives a meaning to spaces, colons
    and `%`: below a workspace with such a path, the folder is a link to one in the temporary folder.
    """
    folder = workspace.path / "hosts"
    if len(os.fsencode(folder)) + _LONGEST_NAME <= LONGEST_SOCKET and _PLAIN.fullmatch(str(folder)):
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder
    if not folder.is_dir():
        folder.unlink(missing_ok=True)
        folder.symlink_to(tempfile.mkdtemp(prefix="midstride-"))
    return folder.resolve()


def remove_socket_folder(workspace: Workspace) -> None:
    """Remove the folder, once nothing uses it, where it is one in the temporary folder."""
    folder = workspace.path / "hosts"
    if folder.is_symlink():
        shutil.rmtree(folder.resolve(), ignore_errors=True)
        folder.unlink(missing_ok=True)


def order_for(system: str, host: HostSpec, own: Backend, *, middleware_settings: bool) -> HostOrder:
    """The order of a manager with the back end ``own`` to the host process of ``host``."""
    variables = {name: os.environ[name] for name in SHARED_VARIABLES if name in os.environ} | {
        name: value for name, value in own.reach().items() if name in SHARED_VARIABLES
    }
    return HostOrder(
        protocol=HOST_PROTOCOL,
        system=system,
        host=host.name,
        backend=own.name,
        folder=host.folder,
        middleware_settings=middleware_settings,
        variables=variables,
    )


class HostsBackend(Backend):
    """``own``: the back end of this host. ``workspace``: the one of the system here, whose name is that of the system.

    The folder of the links' sockets is made in it once there is a host.
    """

    reaches_hosts = True
    # How often the clocks of the hosts are measured besides (s): they drift apart.
    measure_clocks: float | None = 30.0

    def __init__(
        self,
        own: Backend,
        workspace: Workspace,
        *,
        middleware_settings: bool = True,
        connect: Callable[[HostSpec, Path], SshConnection] = SshConnection,
    ) -> None:
        self._own, self._workspace = own, workspace
        self._middleware_settings, self._connect = middleware_settings, connect
        self.name, self.shares_processes, self.clock = own.name, own.shares_processes, own.clock
        self.transport = transport = HostsTransport(own.transport)
        transport.link_of = self._link_of
        self._note: Callable[[str], object] = lambda _: None
        self._superseded: Callable[[], bool] = lambda: False
        self._token = ""
        self._links: dict[str, HostLink] = {}
        self._judged: set[str] = set()  # the hosts of which has been said what is not as it should be
        self._host_of: dict[str, str] = {}  # by instance, those of other hosts
        self._here: set[str] = set()  # the instances that run on this host, or may
        self._on_exit: Callable[[Exited], object] = lambda _: None
        self._spares = (0, "")
        self._measuring = False
        self._tasks: set[asyncio.Task[object]] = set()

    # -- links ---------------------------------------------------------------------------------------------

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        self._on_exit = on_exit
        await self._own.open(self._exited)

    async def close(self) -> None:
        await asyncio.gather(*(link.close() for link in self._links.values()))
        remove_socket_folder(self._workspace)
        for task in self._tasks:
            task.cancel()
        await self._own.close()

    async def reach_hosts(
        self,
        hosts: Mapping[str, HostSpec],
        token: str,
        note: Callable[[str], object],
        superseded: Callable[[], bool],
    ) -> Mapping[str, str]:
        self._token, self._note, self._superseded = token, note, superseded
        for name, host in sorted(hosts.items()):
            known = self._links.get(name)
            if known is not None and known.host != host and not known.handles:
                await known.close()
                known = None
            if known is None:
                self._links[name] = self._link(host)
        await asyncio.gather(*(self._links[name].open() for name in sorted(hosts)))
        if hosts and not self._measuring and self.measure_clocks is not None:
            self._measuring = True
            await self._measure_clocks()
            self._keep(self._measure_again(self.measure_clocks))
        for name in sorted(hosts):
            report = self._links[name].report
            for words in [] if report is None or name in self._judged else faults_of(report):
                note(f"host {name}: {words}")
            if report is not None:
                self._judged.add(name)
        return self.problems()

    async def leave_hosts(self, needed: Container[str]) -> None:
        for name in [name for name, link in self._links.items() if name not in needed and not link.is_used]:
            await self._links.pop(name).close()
            self._judged.discard(name)

    async def _measure_clocks(self) -> None:
        for link in list(self._links.values()):
            if link.connected:
                with contextlib.suppress(BackendError):
                    await link.measure_clock()

    async def _measure_again(self, interval: float) -> None:
        while True:
            await asyncio.sleep(interval)
            await self._measure_clocks()

    def _link_changed(self, words: str) -> None:
        """Report what has become of the link to a host."""
        self._note(words)

    def _link(self, host: HostSpec) -> HostLink:
        order = order_for(self._workspace.name, host, self._own, middleware_settings=self._middleware_settings)
        return HostLink(
            host,
            order,
            self._sockets(),
            lambda: self._token,
            self._exited,
            self._link_changed,
            known=lambda: (*self._here, *self._host_of),
            superseded=lambda: self._superseded(),
            connect=self._connect,
            elsewhere=lambda instance: self.transport.connect(self.transport.address(instance)),
        )

    def _sockets(self) -> Path:
        return socket_folder(self._workspace)

    async def try_again(self, hosts: Collection[str]) -> None:
        await asyncio.gather(*(link.try_again() for name, link in self._links.items() if name in hosts))

    def problems(self) -> dict[str, str]:
        """By host that cannot be reached now: why, and what to do."""
        return {name: link.problem for name, link in sorted(self._links.items()) if link.problem is not None}

    def host_links(self) -> list[HostLinkState]:
        return [link.shown for _, link in sorted(self._links.items())]

    def _link_of(self, instance: str) -> HostLink | None:
        host = self._host_of.get(instance)
        return None if host is None else self._links.get(host)

    def _on(self, host: str) -> HostLink:
        if (link := self._links.get(host)) is None:
            raise Unreachable(f"host {host} is not declared")
        return link

    def _exited(self, exited: Exited) -> None:
        if self._host_of.pop(exited.instance, None) is not None:
            self._own.disconnected(exited.instance)  # the graph may still show it
        self._here.discard(exited.instance)
        self._on_exit(exited)

    # -- components ----------------------------------------------------------------------------------------

    def describe(self, launch: Launch) -> DescribedProcess:
        if not launch.host:
            return self._own.describe(launch)
        return DescribedProcess((*launch.prefix, *launch.arguments), dict(launch.environment))

    async def start(self, launch: Launch) -> Handle:
        if not launch.host:
            self._here.add(launch.instance)
            return await self._own.start(launch)
        try:
            link = self._on(launch.host)
            link.require_connected()
        except Unreachable as error:
            raise StartFailed(f"{launch.instance}: {error}") from None
        self._host_of[launch.instance] = launch.host
        try:
            form = await link.call(calls.Start(launch=LaunchForm.of(launch)), HandleForm, START_SECONDS)
        except BaseException as error:
            self._host_of.pop(launch.instance, None)
            if isinstance(error, (Unreachable, CallTimeout, asyncio.CancelledError)):  # it may have been started
                link.lost(launch.instance)
            if isinstance(error, (Unreachable, CallTimeout)):
                raise StartFailed(f"{launch.instance}: {error}") from None
            raise
        if form.instance != launch.instance:
            raise StartFailed(f"{launch.instance}: host {launch.host} has started {form.instance!r} instead")
        link.handles[launch.instance] = form
        return form.handle(launch.host)

    async def adopt(self, handle: Handle) -> bool:
        if not handle.host:
            self._here.add(handle.instance)
            return await self._own.adopt(handle)
        self._host_of[handle.instance] = handle.host  # also where it is not known whether it runs there
        link, form = self._on(handle.host), HandleForm.of(handle)
        runs = await link.call(calls.Adopt(handle=form), bool)
        if runs:
            link.handles[handle.instance] = form
        else:
            self._host_of.pop(handle.instance, None)
        return runs

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        if instance not in self._host_of:
            killed_here = await self._own.end(instance, stop)
            self._here.discard(instance)
            return killed_here
        seconds = END_SECONDS + stop.longest + stop.asked + stop.drain + stop.patience
        try:
            link = self._on(self._host_of[instance])
            killed = await link.call(
                calls.End(instance=instance, stop=StopTimesForm.of(stop)), list[RemainingForm], seconds
            )
        except (Unreachable, CallTimeout) as error:
            raise EndUnknown(f"{error}; whether {instance} runs there is not known") from None
        link.handles.pop(instance, None)
        self._host_of.pop(instance, None)
        self._own.disconnected(instance)
        return [each.process() for each in killed]

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        ended = await self._own.end_orphans(token, known, stop)
        names = list(known) if isinstance(known, Iterable) else [name for name in self._host_of if name in known]
        for link in self._links.values():
            if link.connected:
                call = calls.EndOrphans(token=token, known=names, stop=StopTimesForm.of(stop))
                ended += await link.call(call, list[str], END_SECONDS + stop.longest)
        return sorted(ended)

    def keep_spares(self, number: int, token: str) -> None:
        self._own.keep_spares(number, token)
        if (number, token) != self._spares or number:
            self._spares = (number, token)
            for link in self._links.values():
                self._later(link, calls.KeepSpares(count=number, token=token))

    def spares(self) -> int:
        return self._own.spares()

    def takes_spare(self, arguments: Sequence[str], directory: Path) -> bool:
        return self._own.takes_spare(arguments, directory)

    def is_stopped(self, instance: str) -> bool:
        link = self._link_of(instance)
        return self._own.is_stopped(instance) if link is None else instance in link.state.stopped

    def disconnected(self, instance: str) -> None:
        self._own.disconnected(instance)

    def reported(self, state: ComponentState) -> None:
        self._own.reported(state)

    def unwritten(self) -> str | None:
        found = [
            f"{link.state.unwritten} (on host {name})" for name, link in self._links.items() if link.state.unwritten
        ]
        return self._own.unwritten() or next(iter(found), None)

    def hanging(self) -> list[str]:
        remote = (f"{words} (on host {name})" for name, link in self._links.items() for words in link.state.hanging)
        return [*self._own.hanging(), *remote]

    def executable(self, package: str, name: str, *, composable: bool = False) -> str | None:
        return self._own.executable(package, name, composable=composable)

    def other_nodes(self, instances: Collection[str]) -> dict[str, OtherNodes]:
        found = self._own.other_nodes([name for name in instances if name not in self._host_of])
        for name in instances:
            link = self._link_of(name)
            if link is not None and (others := link.state.others.get(name)) is not None:
                found[name] = others.others()
        return found

    async def clock_offset(self, host: str) -> ClockOffset:
        return await self._on(host).measure_clock() if host else SAME_CLOCK

    # -- the graph -----------------------------------------------------------------------------------------

    def middleware(self) -> Middleware:
        return self._own.middleware()

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        return await self._own.endpoints(topics)

    def reach(self) -> dict[str, str]:
        return self._own.reach()

    def probe(self) -> AbstractAsyncContextManager[str | None]:
        return self._own.probe()

    def listen(self, topic: str, assumption: Predicate) -> TopicListener:
        return self._own.listen(topic, assumption)

    async def publisher_ids(self, topic: str, instance: str) -> frozenset[str] | None:
        link = self._link_of(instance)
        if link is None:
            return await self._own.publisher_ids(topic, instance)
        found = await link.call(calls.PublisherIds(topic=topic, instance=instance), calls.KnownIds)
        return None if found.ids is None else frozenset(found.ids)

    async def lingering_readers(self, topic: str) -> int:
        count = await self._own.lingering_readers(topic)
        for link in self._links.values():
            if link.connected:
                with contextlib.suppress(BackendError):
                    count += await link.call(calls.LingeringReaders(topic=topic), int)
        return count

    def _later(self, link: HostLink, call: calls.HostCall) -> None:
        """Have a call carried out, without its result."""

        async def carry_out() -> None:
            try:
                await link.call(call, object)
            except BackendError as error:
                log.info("host %s: %s", link.host.name, error)

        if link.connected:
            self._keep(carry_out())

    def _keep(self, work: Coroutine[Any, Any, None]) -> None:
        task: asyncio.Task[object] = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
