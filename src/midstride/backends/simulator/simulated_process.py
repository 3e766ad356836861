"""A simulated process: a component's program in a cooperative thread, which takes work from a queue, item by item."""

from __future__ import annotations

import asyncio
import contextvars
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from midstride.backends.simulator.cooperative_thread import CooperativeThread, Sleeps, ThreadYield
from midstride.backends.simulator.simulated_program import ProcessOutput, SimulatedProgram
from midstride.backends.simulator.virtual_clock import HostClock, SimulatedClock
from midstride.errors import BackendError
from midstride.model.instance_names import full_name
from midstride.node import process_context
from midstride.node.component_host import Host
from midstride.node.diagnostic_status import DiagnosticEntry
from midstride.runtime.backend_protocol import Launch
from midstride.wire.pipe import MEMORY
from midstride.wire.state import ComponentState

# How often what waits for the end of a freeze looks whether it has been ended early (s).
THAW_INTERVAL: Final = 0.1


class SimulatedProcess:
    """Runs ``launch``. ``on_exit(process)`` is called once, when it has ended; ``status`` is then its exit status.

    ``log`` is the file that gets its output, too. ``host`` makes the component's host, given the name of the instance.
    """

    def __init__(
        self,
        launch: Launch,
        pid: int,
        clock: SimulatedClock,
        host: Callable[[SimulatedProcess, str], Host],
        on_exit: Callable[[SimulatedProcess], None],
        log: Path | None = None,
    ) -> None:
        self.instance = launch.instance
        self.token = launch.token
        # The name of the process of a container that it shares with others: a crash of one is a crash of all.
        self.shares = launch.process
        self.pid = pid
        self.clock = clock
        self.log = ProcessOutput(log)
        # The control thread of its component, once it has joined the platform, and what it last published of itself.
        self.main: asyncio.Task[None] | None = None
        self.state: ComponentState | None = None
        self.diagnostics: Callable[[], Sequence[DiagnosticEntry]] = tuple
        self.dead = False
        self.terminating = False
        # Being ended by the manager, which waits for that: its exit is not reported.
        self.exit_expected = False
        self.status: int | None = None
        # Its full name in the graph: ``front/camera`` is node ``camera`` in ``/front``, whatever the namespace.
        self.node = full_name(launch.instance, launch.namespace)
        # The host that it is on. Components of two hosts share no lock: their locks of a cut do not exclude each other.
        self.host, self.on = launch.host, launch.host or MEMORY
        self.own_clock: SimulatedClock | HostClock = clock  # that of its host
        self._on_exit = on_exit
        self._program = self._new_program(launch)
        self._queue: deque[Callable[[], object]] = deque()
        self._scheduled = False
        # Until when it is frozen (steady s); in the past where it is not, and 0 where it has never been.
        self.thawed_at = 0.0
        # The same for when its code does not react: it is frozen, or does not return from a call, while its control
        # thread answers.
        self._reacts_at = 0.0
        # Until when it was frozen, and did not react, before that was ended early (steady s).
        self._was_frozen = self._was_hung = 0.0
        self._asleep = False
        context = contextvars.copy_context()
        own = process_context.ProcessContext(
            factory=lambda name, namespace: host(self, name),
            instance=launch.instance,
            namespace=launch.namespace,
            token=launch.token,
            parameters=dict(launch.parameters),
            set_parameters=dict(launch.set_parameters),
            arguments=self._program.arguments,
            pid=pid,
            standby=launch.standby,
            modules=self._program.modules,
            started=time.time_ns(),
        )
        context.run(process_context.current.set, own)
        self._thread = self._new_thread(context)

    def _new_program(self, launch: Launch) -> SimulatedProgram:
        return SimulatedProgram(launch, self.log)

    def _new_thread(self, context: contextvars.Context) -> CooperativeThread:
        return CooperativeThread(self.instance, self._program.run, context)

    def resume(self, work: Callable[[], object] | None = None) -> None:
        """Let the thread run, and handle what it yields for."""
        if self.dead:
            return
        try:
            yielded = self._run_thread(work)
        except BackendError as error:
            self.log.write(f"{error}\n")
            self.kill()
            return
        if yielded is None:
            self._schedule()
        elif isinstance(yielded, Sleeps):
            self._asleep = True
            self.clock.loop.call_later(yielded.seconds, self._wake)
        else:
            self.kill(self._program.status(yielded.error))

    def _run_thread(self, work: Callable[[], object] | None) -> ThreadYield:
        with self._program.interpreter_state():
            return self._thread.resume(work)

    def enqueue(self, item: Callable[[], object]) -> None:
        """Have the thread call ``item`` after what is queued already."""
        if not self.dead:
            self._queue.append(item)
            self._schedule()

    def _schedule(self) -> None:
        if self._queue and not self._scheduled and not self.dead:
            self._scheduled = True
            if self.reacts:
                self.clock.loop.call_soon(self._work)
            else:
                self.clock.loop.call_later(self._reacts_at - self.clock.steady(), self._work)

    def _work(self) -> None:
        self._scheduled = False
        if not self.reacts:
            self._schedule()
        elif self._queue and not self._asleep and not self.dead:
            self.resume(self._queue.popleft())

    def run_work(self) -> None:
        """In its thread: let the loop run until there is work, and do that."""
        work: Callable[[], object] = self._thread.yield_to_loop(None)
        work()

    def _wake(self) -> None:
        """A `time.sleep` of its code is over."""
        if self.thawed_at > self.clock.steady():
            self.clock.loop.call_later(self.thawed_at - self.clock.steady(), self._wake)
            return
        self._asleep = False
        self.resume()

    def terminate(self) -> None:
        """SIGTERM: a component in ``start()`` ends in order; a process that has not got there ends at once."""
        self.terminating = True
        if self.main is not None:
            self.main.cancel()
        else:
            self.kill(-15)

    def kill(self, status: int = -9) -> None:
        """End it at once, whatever it is doing."""
        if self.dead:
            return
        self.dead = True
        self.status = status
        self._on_exit(self)
        if self.main is not None:
            self.main.cancel()
        with self._program.interpreter_state():
            self._thread.kill()

    @property
    def crashed(self) -> bool:
        """Return whether its container ends with it: it has not left in order, nor failed to load."""
        return self.dead and self.status not in (0, -15) and (self.main is not None or self.status == -9)

    def freeze(self, seconds: float) -> None:
        """Stop the process for ``seconds``, like SIGSTOP and SIGCONT."""
        self.thawed_at = max(self.thawed_at, self.clock.steady() + seconds)
        self._reacts_at = max(self._reacts_at, self.thawed_at)

    def hang(self, seconds: float) -> None:
        """Block a call of its code for ``seconds``."""
        self._reacts_at = max(self._reacts_at, self.clock.steady() + seconds)

    def thaw(self) -> None:
        """End :meth:`freeze` and :meth:`hang`."""
        now = self.clock.steady()
        self._was_frozen, self._was_hung = min(now, self.frozen_until), min(now, self.reacts_since)
        self.thawed_at = self._reacts_at = 0.0
        self._scheduled = False
        self._schedule()

    @property
    def runs(self) -> bool:
        """Return whether the process is neither dead nor frozen."""
        return not self.dead and (not self.thawed_at or self.thawed_at <= self.clock.steady())

    @property
    def reacts_since(self) -> float:
        """Since when it has reacted without interruption, or from when on it will (steady s)."""
        return max(self._reacts_at, self._was_hung)

    @property
    def frozen_until(self) -> float:
        """Until when it was frozen last, or is (steady s); 0 where it never was."""
        return max(self.thawed_at, self._was_frozen)

    @property
    def reacts(self) -> bool:
        """Return whether the process is not frozen, and no call of its code hangs."""
        return not self._reacts_at or self._reacts_at <= self.clock.steady()

    async def wait_while_frozen(self) -> None:
        """Returns once it is not frozen. Raises CancelledError where it is dead, which ends its tasks."""
        while not self.dead and (left := self.thawed_at - self.clock.steady()) > 0:
            await self.clock.sleep(min(left, THAW_INTERVAL))
        if self.dead:
            raise asyncio.CancelledError
