"""The simulator as a back end: the real node code, in virtual time, without ROS."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import ExitStack
from typing import Any, Final, TypeVar

from midstride.backends.simulator import loop as virtual
from midstride.backends.simulator import messages
from midstride.backends.simulator.clock import SimulatedClock
from midstride.backends.simulator.cooperative_thread import simulated_sleep
from midstride.backends.simulator.faults import Faults
from midstride.backends.simulator.network import Network
from midstride.backends.simulator.process import SimulatedProcess
from midstride.errors import BackendError, CallTimeout, StartFailed, Unreachable
from midstride.runtime.backend import Endpoints, Exited, Handle, Launch
from midstride.runtime.clock import Clock
from midstride.wire.messages import Announcement, Command, Reply

T = TypeVar("T")

# Process ids of simulated processes: none that the system could have given to a real one.
FIRST_PID: Final = 5_000_000
# How long it takes until somebody knows that a process has ended (s).
EXIT_SEEN: Final = 0.005


class Simulator:
    """Implements :class:`midstride.runtime.backend.Backend`.

    ``Simulator().run(main())`` runs a coroutine in virtual time and shuts the simulator down after
    it. On any other asyncio loop the simulator runs in real time, and whoever opens it calls
    :meth:`shutdown` in the end. All times are in seconds; the same ``seed`` gives the same run.
    """

    name = "sim"

    def __init__(
        self,
        *,
        latency: float = 0.0005,
        jitter: float = 0.0,
        discovery: float = 0.002,
        starting: float = 0.05,
        seed: int = 0,
    ) -> None:
        if latency <= 0 or discovery <= 0 or jitter < 0 or starting < 0:
            raise BackendError("latency and discovery must be greater than 0, and jitter and starting not negative")
        self.time = SimulatedClock()
        self.clock: Clock = self.time
        self.network = Network(self.time, latency, jitter, discovery, seed)
        self.processes: dict[str, SimulatedProcess] = {}
        self.faults = Faults(self.processes, self.network)
        self._starting = starting
        self._on_event: Callable[[Announcement | Exited], None] | None = None
        self._held = ExitStack()
        self._powered = False
        self._pids = FIRST_PID

    # -- running -----------------------------------------------------------------------------------

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Run ``main`` in virtual time to its end, then shut down: no thread, hook or patch is left behind."""

        async def supervised() -> T:
            self._power()
            try:
                return await main
            finally:
                await self.shutdown()

        return virtual.run(supervised())

    async def shutdown(self) -> None:
        """End everything that runs, at once, and take back what was changed of this process."""
        self._on_event = None
        for process in list(self.processes.values()):
            process.kill()
        self._powered = False
        self._held.close()

    def _power(self) -> None:
        self.time.follow(asyncio.get_running_loop())
        if not self._powered:
            self._held.enter_context(messages.served())
            self._held.enter_context(simulated_sleep())
            self._powered = True

    # -- the back-end protocol ---------------------------------------------------------------------

    async def open(self, on_event: Callable[[Announcement | Exited], None]) -> None:
        self._power()
        self._on_event = on_event

    async def close(self) -> None:
        self._on_event = None

    async def start(self, launch: Launch) -> Handle:
        self._power()
        if launch.instance in self.processes:
            raise StartFailed(f"a component named {launch.instance} runs already")
        self._pids += 1
        process = SimulatedProcess(self, launch, self._pids, self._exited)
        self.processes[launch.instance] = process
        self.time.loop.call_later(self._starting, process.resume)
        # No pid: it is no process of this machine's, and nobody shall send it a signal.
        return Handle(launch.instance, None, self.time.steady(), None)

    async def adopt(self, handle: Handle) -> bool:
        return handle.instance in self.processes

    async def call(self, instance: str, command: Command, timeout: float) -> Reply:
        deadline = self.time.steady() + timeout
        fault = self.faults.of_call(instance, command.op)
        process = self.processes.get(instance)
        if process is None or fault == "unreachable":
            raise Unreachable(f"no component {instance} runs")
        if fault == "refused":
            return Reply(-1, {}, "the simulator was told to refuse this call")
        if fault == "lost_request":
            await self.time.sleep(timeout)
            raise CallTimeout(f"{instance} did not answer within {timeout:g} s")
        await self.time.sleep(self.network.latency)
        answer = self.time.loop.create_task(self._serve(process, Command.from_json(command.to_json())))
        gone = self.time.loop.create_task(process.gone.wait())
        try:
            left = max(deadline - self.time.steady() - self.network.latency, 0.0)
            await asyncio.wait({answer, gone}, timeout=left, return_when=asyncio.FIRST_COMPLETED)
        finally:
            gone.cancel()
        if answer.done() and not answer.cancelled() and fault is None:
            await self.time.sleep(self.network.latency)
            return Reply.from_json(answer.result().to_json())
        if process.dead:
            raise Unreachable(f"{instance} ended during the call")
        await self.time.sleep(max(deadline - self.time.steady(), 0.0))
        raise CallTimeout(f"{instance} did not answer within {timeout:g} s")

    async def _serve(self, process: SimulatedProcess, command: Command) -> Reply:
        """A process that is not up yet, or frozen, answers later."""
        while process.host is None or process.host.serve is None:
            await self.time.sleep(self.network.discovery)
            await process.thaw()
        await process.thaw()
        reply = await process.host.serve(command)
        await process.thaw()
        return reply

    async def end(self, instance: str, grace: float) -> None:
        process = self.processes.get(instance)
        if process is None:
            return
        process.awaited = True
        process.terminate()
        deadline = self.time.steady() + grace
        while not process.dead and self.time.steady() < deadline:
            await self.time.sleep(min(0.01, grace))
        process.kill()

    async def endpoints(self) -> Endpoints:
        topics = self.network.topics.items()
        return Endpoints(
            nodes=frozenset(process.node for process in self.processes.values() if process.host is not None),
            publishers=tuple((w.owner.node, name) for name, topic in topics for w in topic.writers),
            subscribers=tuple((r.owner.node, name) for name, topic in topics for r in topic.readers),
        )

    # -- for processes -----------------------------------------------------------------------------

    def announce(self, announcement: Announcement) -> None:
        told = Announcement.from_json(announcement.to_json())
        self.time.loop.call_later(self.network.latency, self._tell, told)

    def register(self, instance: str, process: SimulatedProcess) -> None:
        """``process`` is on the platform as ``instance``. Raises StartFailed where the name is taken."""
        if self.processes.get(instance) is not process:
            raise StartFailed(f"a node named {instance} is in the graph already")

    def _exited(self, process: SimulatedProcess) -> None:
        if self.processes.get(process.instance) is process:
            del self.processes[process.instance]
        if not process.awaited:
            told = Exited(process.instance, process.status, process.log.tail(20))
            self.time.loop.call_later(EXIT_SEEN, self._tell, told)

    def _tell(self, event: Announcement | Exited) -> None:
        if self._on_event is not None:
            self._on_event(event)

    # -- looking -----------------------------------------------------------------------------------

    def log(self, instance: str) -> str:
        """What a running component has written to its output."""
        return self.processes[instance].log.tail()

    def state(self, instance: str) -> dict[str, Any]:
        """What a running component last published of its state."""
        host = self.processes[instance].host
        return {} if host is None else dict(host.state)
