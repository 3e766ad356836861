"""The hosts of a simulated system besides the manager's: the real link, host process and back end, without SSH.

Each manager has its links to them (`runtime/hosts/host_link.py`), over lines that faults cut and slow down
(`backends/simulator/links.py`). A host process serves the part of the simulated platform that is on its host; killed,
it is started again by the next connection, as `ssh HOST midstride host` does. Its components keep running.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from midstride.backends.simulator.control import ControlOfHost
from midstride.backends.simulator.virtual_clock import HostClock, SimulatedClock
from midstride.model.component import StopTimes
from midstride.model.hosts import HostSpec
from midstride.runtime.backend_protocol import (
    Backend,
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    Launch,
    RemainingProcess,
)
from midstride.runtime.hosts.host_frames import HOST_PROTOCOL
from midstride.runtime.hosts.host_order import HostOrder, HostReport
from midstride.runtime.hosts.host_service import HostService
from midstride.runtime.hosts.hosts_backend import HostsBackend
from midstride.runtime.hosts.ssh import CONNECT_SECONDS
from midstride.runtime.hosts.ssh_connection import HostFault, SshConnection
from midstride.runtime.records.status_forms import Middleware
from midstride.runtime.workspace import Workspace
from midstride.simulation.killable_manager import Life
from midstride.simulation.platform import Platform
from midstride.simulation.stream_wires import Streams, Wire, wires
from midstride.wire.clock_offset import SAME_CLOCK, ClockOffset
from midstride.wire.pipe import MEMORY
from midstride.wire.transport import Transport

# How long a login takes (s), and the way of what is sent to another host.
LOGIN: Final = 0.2
LATENCY: Final = 0.001
# For how long a line is cut until the connection over it is given up, as OpenSSH does; and how often that is looked at.
SILENCE: Final = 5.0
LOOK: Final = 0.5
# By how much the clock of a host is ahead of the manager's (s), and how fast it is (s for each s).
OFFSETS: Final = (0.0, 0.0003, -0.02, 0.15, -0.6)
DRIFTS: Final = (0.0, 5e-5, -5e-5, 5e-4, -5e-4)


def drawn_clocks(hosts: Iterable[str], clock: SimulatedClock, seed: int) -> dict[str, HostClock]:
    """The clocks of ``hosts``: of the manager's they are off by as much as those of computers may be."""
    drawn = random.Random(f"clocks of hosts, {seed}")
    return {host: HostClock(clock, drawn.choice(OFFSETS), drawn.choice(DRIFTS)) for host in sorted(hosts)}


class PartOfHost(Backend):
    """The part of the platform that is on one host, for the program that watches it there."""

    name = "sim"

    def __init__(self, platform: Platform, host: str) -> None:
        self._platform, self._host = platform, host
        self.clock = platform.clock
        self.transport: Transport = ControlOfHost(platform.control, host)

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        self._platform.host_exits[self._host] = on_exit

    async def close(self) -> None:
        """The components keep running."""

    def describe(self, launch: Launch) -> DescribedProcess:
        return self._platform.describe(launch)

    async def start(self, launch: Launch) -> Handle:
        return await self._platform.start(replace(launch, host=self._host))

    def _has(self, instance: str) -> bool:
        process = self._platform.processes.get(instance)
        return process is not None and process.host == self._host

    async def adopt(self, handle: Handle) -> bool:
        return self._has(handle.instance)

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        return await self._platform.end(instance, stop) if self._has(instance) else []

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        return await self._platform.end_orphans(token, known, stop, host=self._host)

    def is_stopped(self, instance: str) -> bool:
        return self._platform.is_stopped(instance)

    def middleware(self) -> Middleware:
        return self._platform.middleware()

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        return await self._platform.endpoints(topics)

    async def publisher_ids(self, topic: str, instance: str) -> frozenset[str]:
        return await self._platform.publisher_ids(topic, instance)

    def probe(self) -> AbstractAsyncContextManager[str | None]:
        return self._platform.probe()


class FarHost:
    """A host besides the manager's, with its host process."""

    def __init__(self, name: str, platform: Platform) -> None:
        self.name, self._platform = name, platform
        self._service: HostService | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._wires: list[Wire] = []

    async def run(self, order: HostOrder) -> None:
        """Start its host process unless that runs."""
        if self._service is None:
            part = PartOfHost(self._platform, self.name)
            service = HostService(part, order, directory=Path("/"), logs=Path("/"), version="")
            await service.open()
            self._service = service
            self._keep(self._watch(service))

    async def _watch(self, service: HostService) -> None:
        await service.watch()
        if self._service is service:
            self.kill()

    def _keep(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def connect(self) -> Wire:
        """The manager's end of a new connection to its host process; at once over if that does not run."""
        near, far = wires(self._platform.network.links, MEMORY, self.name, LATENCY, asyncio.get_running_loop())
        if self._service is None:
            far.close()
        else:
            self._wires = [each for each in self._wires if not each.closed] + [far]
            self._keep(self._service.accepted(*far.streams))
        return near

    @property
    def runs(self) -> bool:
        """Return whether its host process runs."""
        return self._service is not None

    def kill(self) -> None:
        """Kill its host process, and so end its connections. Whoever exits from now on is told to nobody."""
        self._service = None
        self._platform.host_exits[self.name] = lambda exited: None
        ended, self._wires = self._wires, []
        for task in sorted(self._tasks, key=lambda task: (len(task.get_name()), task.get_name())):
            task.cancel()
        for each in ended:
            each.close()


class SimulatedSsh(SshConnection):
    """A connection of one manager to a host, in the place of OpenSSH's."""

    def __init__(self, host: HostSpec, folder: Path, hosts: SimulatedHosts) -> None:
        super().__init__(host, folder)
        self._hosts, self._far = hosts, hosts.far(host.name)
        self._wires: list[Wire] = []
        self._over: asyncio.Future[str] | None = None

    async def open(self, order: HostOrder, environment: Mapping[str, str] = {}) -> HostReport:
        await self._hosts.life.breath()
        waited = 0.0
        while self._hosts.is_cut(self.host.name):
            if waited >= CONNECT_SECONDS:
                raise HostFault("it cannot be reached over the network")
            await asyncio.sleep(LOOK)
            waited += LOOK
        await asyncio.sleep(LOGIN)
        await self._far.run(order)
        await self._hosts.life.breath()
        self._over = asyncio.get_running_loop().create_future()
        self._hosts.connections.append(self)
        self._hosts.reached_at = self._hosts.clock.steady()
        self.report = HostReport(midstride_host=HOST_PROTOCOL, socket="/host.sock", components=f"/{self.host.name}")
        return self.report

    async def channel(self, name: str) -> Streams:
        self._wires = [each for each in self._wires if not each.closed]
        self._wires.append(wire := self._far.connect())
        return wire.streams

    async def ended(self) -> str:
        assert self._over is not None
        cut = 0.0
        while not self._over.done():
            await asyncio.wait((self._over,), timeout=LOOK)
            cut = cut + LOOK if self._hosts.is_cut(self.host.name) else 0.0
            if cut >= SILENCE:
                return "its connection is silent"
        return self._over.result()

    async def close(self) -> None:
        self.end()

    def end(self, because: str = "its connection has ended") -> None:
        """The connection is over at this end; the other one hears of it if the line is not cut."""
        with suppress(ValueError):
            self._hosts.connections.remove(self)
        if self._over is not None and not self._over.done():
            self._over.set_result(because)
        for each in self._wires:
            each.close()

    def abandon(self) -> None:
        """The manager has been killed, and hears of nothing any more."""
        for each in self._wires:
            each.abandon()


class SimulatedHosts(HostsBackend):
    """The back end of one manager. ``life``: of the manager, to be set before it is used."""

    life: Life
    measure_clocks = None  # they are known

    def __init__(self, platform: Platform, workspace: Workspace, hosts: dict[str, FarHost]) -> None:
        super().__init__(PartOfHost(platform, ""), workspace, connect=self._simulated)
        self._platform, self._hosts = platform, hosts
        self.reached_at = 0.0  # when a host was last reached or lost (steady s)
        self.connections: list[SimulatedSsh] = []

    def _simulated(self, host: HostSpec, folder: Path) -> SshConnection:
        return SimulatedSsh(host, folder, self)

    async def clock_offset(self, host: str) -> ClockOffset:
        """The offset, as it is measured over a line that takes as long there as back."""
        own, other = self._platform.time, self._platform.clocks.get(host)
        if other is None:
            return SAME_CLOCK
        return ClockOffset(other.system_now() - own.system_now(), round(LATENCY * 1e9), own.system_now())

    def _link_changed(self, words: str) -> None:
        self.reached_at = self.clock.steady()  # a login is not enough: the line may be cut right after it
        if self.life.is_back and (connected := [name for name, link in self._links.items() if link.connected]):
            self.life.on_connected(f"has connected to {', '.join(connected)}")
        super()._link_changed(words)

    def _sockets(self) -> Path:
        return Path("simulated")

    def far(self, name: str) -> FarHost:
        if name not in self._hosts:
            self._platform.far[name] = self._hosts[name] = FarHost(name, self._platform)
        return self._hosts[name]

    def is_cut(self, host: str) -> bool:
        links = self._platform.network.links
        return links.is_cut(MEMORY, host) or links.is_cut(host, MEMORY)

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        def exited(event: Exited) -> None:
            if self.life.alive:
                on_exit(event)

        await super().open(exited)

    def listen(self, topic: str, assumption: Any) -> Any:
        return self._platform.listen(topic, assumption)

    async def end_unexpectedly(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        """End ``instance`` by a manager that another one has superseded, which does not expect the exit."""
        if instance in self._host_of:
            return await self.end(instance, stop)
        return await self._platform.end_unexpectedly(instance, stop)

    def killed(self) -> None:
        """The manager has been killed: its connections end."""
        for each in self.connections:
            each.abandon()

    def isolated(self) -> None:
        """The manager is cut off: its connections have ended once it is back."""
        for each in list(self.connections):
            each.end()
