"""The simulated platform of a seed: stand-ins as processes, and a state store whose disk may fail."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from midstride.backends.simulator.backend import Simulator
from midstride.backends.simulator.injected_faults import beside
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.backends.simulator.virtual_clock import HostClock
from midstride.model.component import StopTimes
from midstride.node.component_host import Host
from midstride.runtime.backend_protocol import Handle, Launch, RemainingProcess
from midstride.simulation.stand_in import StandIn
from midstride.wire.pipe import MEMORY


class Far(Protocol):
    """A host besides the manager's, whose host process may run."""

    name: str

    @property
    def runs(self) -> bool: ...

    def kill(self) -> None:
        """Kill its host process."""


class Platform(Simulator):
    """``on_change(process)`` is called when a process has started, has published its state, or has ended.

    ``on_import(process, exporter)`` is called when it has imported the state of the instance ``exporter``.
    """

    on_import: Callable[[StandIn, str], None]

    def __init__(self, on_change: Callable[[StandIn], None]) -> None:
        super().__init__(jitter=0.0005)
        # The next process to be started ends at once.
        self.next_start_fails = False
        # On how many hosts the processes run that are started from now on.
        self.hosts = 1
        # The declared hosts besides the manager's, once there are any.
        self.far: dict[str, Far] = {}
        self._later: list[asyncio.TimerHandle] = []
        # By declared host, where its clocks differ from those of the manager's.
        self.clocks: dict[str, HostClock] = {}
        self._on_change = on_change

    def standing(self, instance: str) -> StandIn | None:
        """The process of ``instance``, if it runs."""
        found = self.processes.get(instance)
        return found if isinstance(found, StandIn) else None

    def stand_ins(self) -> list[StandIn]:
        return [process for _, process in sorted(self.processes.items()) if isinstance(process, StandIn)]

    def host_names(self) -> list[str]:
        """The hosts between which there are lines."""
        if self.far:
            return sorted({MEMORY, *self.far})
        return sorted({process.on for process in self.processes.values()})

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Call it so much later, unless the faults are over by then."""
        self._later.append(self.time.loop.call_later(seconds, call))

    async def start(self, launch: Launch) -> Handle:
        handle = await super().start(launch)
        if self.next_start_fails:
            self.next_start_fails = False
            self.time.loop.call_later(self.starting / 2, self.processes[launch.instance].kill, 1)
        return handle

    async def end_unexpectedly(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        """End ``instance`` by a manager that another one has superseded, which does not expect the exit."""
        if (process := self.standing(instance)) is None:
            return []
        process.terminate()
        deadline = self.time.steady() + stop.longest
        while not process.dead and self.time.steady() < deadline:
            await self.time.sleep(0.01)
        if not beside(process, self.processes):
            process.kill()
        return []

    def heal(self) -> None:
        """End every fault of the platform. A middleware that finds no endpoints any more needs a new process."""
        self.faults.clear()
        for handle in self._later:
            handle.cancel()
        self._later.clear()
        self.network.links.clear()
        self.starting = 0.05
        self.next_start_fails = False
        for topic in self.network.topics.values():
            topic.dropping, topic.delay = 0, 0.0
        for owner in list(self.network.undiscovering):
            if isinstance(owner, SimulatedProcess):
                owner.kill()
        self.network.undiscovering.clear()
        for process in self.stand_ins():
            process.thaw()
            for behaviour in process.modes.values():
                behaviour.clear()

    def _process(self, launch: Launch, log: Path | None) -> SimulatedProcess:
        process = StandIn(launch, self._pids, self.time, self._host, self._exited, log)
        process.on_state, process.on_import = self._on_change, self.on_import
        if not launch.host:
            process.on = f"host {self._pids % self.hosts}" if self.hosts > 1 else MEMORY
        process.own_clock = self.clocks.get(launch.host, self.time)
        return process

    def _host(self, process: SimulatedProcess, name: str) -> Host:
        host = super()._host(process, name)
        assert isinstance(process, StandIn)
        process.admission = host.admission
        return host

    def _exited(self, process: SimulatedProcess) -> None:
        super()._exited(process)
        assert isinstance(process, StandIn)
        process.exited_at = self.time.steady()
        self._on_change(process)
