"""The simulator as a back end: the real node code, in virtual time, without ROS."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Collection, Container, Coroutine, Sequence
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from midstride.backends.simulator import type_imports
from midstride.backends.simulator import virtual_loop as virtual
from midstride.backends.simulator.control import SimulatedControl
from midstride.backends.simulator.cooperative_thread import simulated_sleep
from midstride.backends.simulator.host import SimulatedHost
from midstride.backends.simulator.injected_faults import Faults, beside
from midstride.backends.simulator.manager_listener import MANAGER, SimulatedListener
from midstride.backends.simulator.network import Network
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.backends.simulator.simulated_program import ProcessOutput, SimulatedProgram
from midstride.backends.simulator.virtual_clock import SimulatedClock
from midstride.errors import BackendError, StartFailed
from midstride.model.component import StopTimes
from midstride.model.contract import Predicate
from midstride.model.instance_names import PRIVATE_NAMES, full_name, log_file_name
from midstride.node.component_host import Host
from midstride.node.diagnostic_status import DiagnosticEntry
from midstride.runtime.backend_protocol import (
    Backend,
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    Launch,
    RemainingProcess,
)
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.log_runs import begin_run
from midstride.runtime.records.status_forms import Middleware
from midstride.wire.state import ComponentState
from midstride.wire.transport import Transport

T = TypeVar("T")

# Process ids of simulated processes: none that the system could have given to a real one.
FIRST_PID: Final = 5_000_000
# How long after a process has ended its exit is reported (s).
EXIT_LATENCY: Final = 0.005


class Simulator(Backend):
    """``Simulator().run(main())`` runs a coroutine in virtual time and shuts the simulator down after it. On a
    :class:`PacedLoop` it keeps step with real time, and on any other asyncio loop runs in real time; call
    :meth:`shutdown` at the end. All times are in seconds; the same
    ``seed`` gives the same run. ``logs``: the folder for the output of the components, one file for each. Hosts are
    names here, whose components share no lock; the manager reaches each of them directly.
    """

    name = "sim"
    reaches_hosts = True

    def __init__(
        self,
        *,
        latency: float = 0.0005,
        jitter: float = 0.0,
        discovery: float = 0.002,
        starting: float = 0.05,
        seed: int = 0,
        logs: Path | None = None,
    ) -> None:
        if latency <= 0 or discovery <= 0 or jitter < 0 or starting < 0:
            raise BackendError("latency and discovery must be greater than 0, and jitter and starting not negative")
        self.time = SimulatedClock()
        self.clock: Clock = self.time
        self.network = Network(self.time, latency, jitter, discovery, seed)
        self.processes: dict[str, SimulatedProcess] = {}
        self.faults = Faults(self.processes, self.network)
        self.control = SimulatedControl(self.network.links, latency, self.faults)
        self.transport: Transport = self.control
        self.starting = starting  # how long the processes take that are started from now on (s)
        self._logs = logs
        self._on_exit: Callable[[Exited], None] = lambda exited: None
        # Who is told of exits on a host, where that is not the manager itself.
        self.host_exits: dict[str, Callable[[Exited], None]] = {}
        self._patches = ExitStack()
        self._active = False
        self._pids = FIRST_PID
        self._probes = 0

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Run ``main`` in virtual time to its end, then shut down: no thread, import hook or patch remains."""

        async def supervised() -> T:
            self._activate()
            try:
                return await main
            finally:
                await self.shutdown()

        return self._on_loop(supervised())

    def _on_loop(self, main: Coroutine[Any, Any, T]) -> T:
        return virtual.run(main)

    async def shutdown(self) -> None:
        """Kill everything that runs, and undo what was changed in this process."""
        self._on_exit = lambda exited: None
        for process in list(self.processes.values()):
            process.kill()
        self._active = False
        self._patches.close()

    def _activate(self) -> None:
        self.time.follow(asyncio.get_running_loop())
        if not self._active:
            self._patches.enter_context(type_imports.served())
            self._patches.enter_context(simulated_sleep())
            self._active = True

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        self._activate()
        self._on_exit = on_exit

    async def close(self) -> None:
        self._on_exit = lambda exited: None

    def describe(self, launch: Launch) -> DescribedProcess:
        SimulatedProgram(launch, ProcessOutput())  # which refuses what it cannot run
        return DescribedProcess(launch.arguments)

    async def start(self, launch: Launch) -> Handle:
        self._activate()
        if launch.instance in self.processes:
            raise StartFailed(f"a component named {launch.instance} is running already")
        self._pids += 1
        name = full_name(launch.instance, launch.namespace)
        log = None if self._logs is None else self._logs / log_file_name(name)
        if log is not None:
            begin_run(log, launch.instance)
        process = self._process(launch, log)
        self.processes[launch.instance] = process
        self.time.loop.call_later(self.starting, process.resume)
        # No pid: it is not a process of this machine, and must not be sent a signal.
        return Handle(launch.instance, None, self.time.steady(), None if log is None else str(log))

    async def adopt(self, handle: Handle) -> bool:
        return handle.instance in self.processes

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        """Simulated programs use Midstride's API: SIGINT and SIGTERM are one to them.

        One that shares the process of a container leaves it, and the others keep running. Raises BackendError where it
        does not: it can only be killed with them.
        """
        process = self.processes.get(instance)
        if process is None:
            return []
        process.exit_expected = True
        await self._exits(process, stop.asked)
        process.terminate()
        await self._exits(process, stop.longest)
        if not process.dead and stop.longest and (others := beside(process, self.processes)):
            process.exit_expected = False
            names = ", ".join(sorted(each.instance for each in others))
            raise BackendError(f"{instance} goes on in {process.shares}: it can only end with {names}")
        killed = (
            [] if process.dead or not stop.longest else [RemainingProcess(process.pid, process.instance, stop.longest)]
        )
        process.kill()
        return killed

    async def _exits(self, process: SimulatedProcess, seconds: float) -> None:
        """Wait until a process is dead, no longer than that."""
        deadline = self.time.steady() + seconds
        while not process.dead and self.time.steady() < deadline:
            await self.time.sleep(min(0.01, seconds))

    async def end_orphans(
        self, token: str, known: Container[str], stop: StopTimes, host: str | None = None
    ) -> list[str]:
        """``host``: those on that one; None: those on any."""
        found = self.processes.items()
        started = {name for name, each in found if each.token == token and host in (None, each.host)}
        orphans = sorted(name for name in started if name not in known)
        for name in orphans:
            await self.end(name, stop)
        return orphans

    def is_stopped(self, instance: str) -> bool:
        process = self.processes.get(instance)
        return process is not None and process.thawed_at > self.time.steady()

    def middleware(self) -> Middleware:
        return Middleware(name="none: messages stay in the manager's process")

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        found = [(name, each) for name, each in self.network.topics.items() if topics is None or name in topics]
        return Endpoints(
            nodes=frozenset(process.node for process in self.processes.values() if process.main is not None),
            publishers=tuple((w.owner.node, name) for name, topic in found for w in topic.writers),
            subscribers=tuple(
                (r.owner.node, name) for name, topic in found for r in topic.readers if r.owner.node != MANAGER
            ),
        )

    async def publisher_ids(self, topic: str, instance: str) -> frozenset[str]:
        writers = () if topic not in self.network.topics else self.network.topics[topic].writers
        return frozenset(writer.identity for writer in writers if writer.owner is self.processes.get(instance))

    @asynccontextmanager
    async def probe(self) -> AsyncIterator[str | None]:
        self._probes += 1
        topic = f"{PRIVATE_NAMES}probe_{self._probes}"
        self.network.probes[topic] = self.time.steady()
        try:
            yield topic
        finally:
            del self.network.probes[topic]

    def listen(self, topic: str, assumption: Predicate) -> SimulatedListener:
        return SimulatedListener(self.network, topic, assumption)

    def _process(self, launch: Launch, log: Path | None) -> SimulatedProcess:
        return SimulatedProcess(launch, self._pids, self.time, self._host, self._exited, log)

    def _host(self, process: SimulatedProcess, name: str) -> Host:
        return SimulatedHost(process, name, self.network, self.control.of(process))

    def _exited(self, process: SimulatedProcess) -> None:
        self.network.remove_process(process)
        self.control.remove(process)
        if self.processes.get(process.instance) is process:
            del self.processes[process.instance]
        if not process.exit_expected:
            event = Exited(process.instance, process.status, process.log.tail(20))
            self.time.loop.call_later(EXIT_LATENCY, lambda: self.host_exits.get(process.host, self._on_exit)(event))
        if process.crashed:
            for each in beside(process, self.processes):
                each.kill(-9)

    def log(self, instance: str) -> str:
        """The output of a running component."""
        return self.processes[instance].log.tail()

    def state(self, instance: str) -> ComponentState | None:
        """The state that a running component last published."""
        return self.processes[instance].state

    def diagnostics(self, instance: str) -> Sequence[DiagnosticEntry]:
        """The diagnostics that a running component last published."""
        return self.processes[instance].diagnostics()
