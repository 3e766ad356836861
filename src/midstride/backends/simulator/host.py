"""A component's host in the simulator. Its data thread takes work from a queue, one item at a time."""

from __future__ import annotations

import asyncio
import io
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Protocol, TypeVar

from midstride.backends.simulator.clock import SimulatedClock
from midstride.backends.simulator.network import Network, SimulatedReader, SimulatedWriter
from midstride.backends.simulator.timer import SimulatedTimer
from midstride.errors import CommandRefused, MidstrideError
from midstride.model.contract import QoS
from midstride.node.contracts import type_name
from midstride.node.host import MessageInfo
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

T = TypeVar("T")


class HostProcess(Protocol):
    """The process that a host runs in."""

    host: SimulatedHost | None
    terminating: bool
    clock: SimulatedClock
    network: Network
    transport: Transport

    @property
    def log(self) -> io.TextIOBase:
        """Its standard output and error."""
        ...

    @property
    def dead(self) -> bool: ...

    @property
    def node(self) -> str:
        """The full name of its node."""
        ...

    def ready(self) -> bool:
        """Whether its thread is waiting for work."""
        ...

    def resume(self, work: Callable[[], None]) -> None:
        """Let its thread run ``work``."""
        ...

    def wait_for_work(self) -> Callable[[], None]:
        """In its thread: let the loop run until there is work."""
        ...

    def frozen_until(self) -> float: ...

    def frozen_until_on_loop(self) -> float: ...

    async def wait_while_frozen(self) -> None: ...

    def join_platform(self, instance: str) -> None:
        """Raises StartFailed where the name is taken."""
        ...


class SimulatedSleep:
    """What an async mode function awaits to sleep."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __await__(self) -> Any:
        yield self


class SimulatedHost:
    """Implements :class:`midstride.node.host.Host`."""

    backend = "sim"

    def __init__(self, process: HostProcess, instance: str) -> None:
        self.instance = instance
        self.transport: Transport | None = process.transport
        self.state: ComponentState | None = None
        self.main: asyncio.Task[None] | None = None
        self._process = process
        self._clock = process.clock
        self._queue: deque[Callable[[], None]] = deque()
        self._scheduled = False
        self._ended = False
        self._parameters: dict[str, Callable[[Any], None] | None] = {}
        self._values: dict[str, Any] = {}
        self._logger = logging.Logger(instance)
        handler = logging.StreamHandler(process.log)
        handler.setFormatter(logging.Formatter("[%(levelname)s] [%(name)s]: %(message)s"))
        self._logger.addHandler(handler)

    def now(self) -> int:
        return self._clock.ros_now()

    def steady(self) -> int:
        return self._clock.steady_ns()

    @property
    def logger(self) -> logging.Logger:
        return self._logger

    @property
    def ros_node(self) -> None:
        return None

    # -- data thread -----------------------------------------------------------------------------

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        future: asyncio.Future[T] = self._clock.loop.create_future()
        if self._process.dead:
            future.cancel()
            return future

        def item() -> None:
            try:
                result = function()
            except Exception as error:
                self._settle(future, None, error)
            else:
                self._settle(future, result, None)

        self.enqueue(item)
        return future

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        def step() -> None:
            try:
                waited_for = coroutine.send(None)
            except StopIteration:
                done()
                return
            if isinstance(waited_for, SimulatedSleep):
                self._clock.loop.call_later(waited_for.seconds, self.enqueue, step)
            elif isinstance(waited_for, asyncio.Future):
                waited_for._asyncio_future_blocking = False
                waited_for.add_done_callback(lambda _: self.enqueue(step))
            else:
                self.enqueue(step)

        step()

    def pause(self, seconds: float) -> Awaitable[None]:
        return SimulatedSleep(seconds)

    def create_publisher(self, topic: str, type_: type, qos: QoS) -> SimulatedWriter:
        return self._process.network.create_writer(self._process, topic, type_name(type_), qos)

    def create_subscription(
        self, topic: str, type_: type, qos: QoS, callback: Callable[[Any, Any], None]
    ) -> SimulatedReader:
        def take() -> None:
            if reader.queue and not reader.gone:
                callback(*reader.queue.popleft())

        network = self._process.network
        reader = network.create_reader(self._process, topic, type_name(type_), qos, lambda: self.enqueue(take))
        return reader

    def read_info(self, info: Any) -> MessageInfo:
        return MessageInfo(*info)

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> SimulatedTimer:
        return SimulatedTimer(self._clock, self.enqueue, round(period * 1e9), epoch, callback)

    def enqueue(self, item: Callable[[], None]) -> None:
        """Have the thread call ``item`` in its turn."""
        if not self._process.dead:
            self._queue.append(item)
            self._schedule()

    def _schedule(self) -> None:
        if not self._scheduled and not self._process.dead:
            self._scheduled = True
            if self._process.frozen_until() > self._clock.steady():
                self._clock.loop.call_at(self._process.frozen_until_on_loop(), self._work)
            else:
                self._clock.loop.call_soon(self._work)

    def _work(self) -> None:
        self._scheduled = False
        if self._process.frozen_until() > self._clock.steady():
            self._schedule()
        elif self._queue and self._process.ready():
            self._process.resume(self._queue.popleft())

    def idle(self) -> None:
        """The thread has finished an item: schedule the next one."""
        if self._queue:
            self._schedule()

    def _settle(self, future: asyncio.Future[Any], result: Any, error: Exception | None) -> None:
        if future.done():
            return
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)

    # -- control thread --------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        await self._process.wait_while_frozen()

    def reachable(self) -> str:
        return "in this simulation"

    def publish_state(self, state: ComponentState) -> None:
        self.state = state

    def extra_endpoints(self) -> list[Endpoint]:
        return []

    def parameter(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        self._parameters[name] = on_change
        self._values[name] = default
        return default

    def set_parameters(self, values: dict[str, Any]) -> None:
        before = dict(self._values)
        done: list[str] = []
        try:
            for name, value in values.items():
                if name not in before:
                    raise CommandRefused(f"there is no parameter {name}")
                self._change(name, value)
                done.append(name)
        except Exception as error:
            for name in reversed(done):
                self._change(name, before[name])
            raise error if isinstance(error, CommandRefused) else CommandRefused(_words(error)) from None

    def _change(self, name: str, value: Any) -> None:
        on_change = self._parameters[name]
        if on_change is not None:
            on_change(value)
        self._values[name] = value

    # -- the component's thread ------------------------------------------------------------------

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        self._process.join_platform(self.instance)

        async def control() -> None:
            await main()

        self._process.host = self
        self.main = self._clock.loop.create_task(control())
        self.main.add_done_callback(lambda _: self.enqueue(self._end))
        if self._process.terminating:  # it was signalled while it started
            self.main.cancel()
        while not self._ended:
            self._process.wait_for_work()()
        if not self.main.cancelled() and (error := self.main.exception()) is not None:
            raise error

    def _end(self) -> None:
        self._ended = True


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, MidstrideError) else f"{type(error).__name__}: {error}"
