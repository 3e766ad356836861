"""A component's host in the simulator. Its data thread is the thread of its process."""

from __future__ import annotations

import asyncio
import inspect
import logging
import threading
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from functools import partial
from typing import Any, TypeVar

from midstride.backends.common import KeptParameters
from midstride.backends.retiring_server import taken_up
from midstride.backends.simulator.cooperative_thread import Sleeps
from midstride.backends.simulator.network import Network, SimulatedReader, SimulatedWriter
from midstride.backends.simulator.service_endpoints import (
    SimulatedActionClient,
    SimulatedActionServer,
    SimulatedClient,
    SimulatedServer,
)
from midstride.backends.simulator.service_network import ServiceEnd
from midstride.backends.simulator.simulated_future import SimulatedFuture
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.backends.simulator.virtual_clock import SimulatedTimer
from midstride.model.contract import QoS
from midstride.node.author.declared_contracts import type_name
from midstride.node.clock_history import ClockHistory
from midstride.node.component_host import GoalAnswers, MessageInfo, NodeParameters
from midstride.node.diagnostic_status import DiagnosticEntry
from midstride.node.process_context import find
from midstride.node.request_admission import RequestAdmission
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

T = TypeVar("T")


class SimulatedHost:
    """Implements :class:`midstride.node.component_host.Host`."""

    ros_node = None
    node_name = None
    publishes_ros_time = False
    has_services = True
    reachable = "in this simulation"

    def __init__(self, process: SimulatedProcess, instance: str, network: Network, transport: Transport) -> None:
        self.instance = instance
        self.transport: Transport | None = transport
        self.managed = False
        self.parameters: NodeParameters = KeptParameters()
        self.now = process.own_clock.ros_now
        self.message_now = process.own_clock.system_now
        self.steady = process.own_clock.steady_ns
        self.admission = RequestAdmission(self.steady, is_open=not find().standby)
        self.logger = logging.Logger(instance)
        self._process = process
        self._network = network
        self._clock = process.own_clock
        self._servers: dict[str, SimulatedServer] = {}
        self._action_servers: dict[str, SimulatedActionServer] = {}
        handler = logging.StreamHandler(process.log)
        handler.setFormatter(logging.Formatter("[%(levelname)s] [%(name)s]: %(message)s"))
        self.logger.addHandler(handler)

    @property
    def simulated_time(self) -> bool:
        return self._clock.driven

    @property
    def clock_history(self) -> ClockHistory:
        return self._clock.history

    # -- data thread -----------------------------------------------------------------------------

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        future: asyncio.Future[T] = self._clock.loop.create_future()
        if self._process.dead:
            future.cancel()

        def item() -> None:
            try:
                resolve = partial(future.set_result, function())
            except Exception as error:
                resolve = partial(future.set_exception, error)
            if not future.done():
                resolve()

        self._process.enqueue(item)
        return future

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        enqueue = self._process.enqueue

        def step() -> None:
            try:
                waited_for = coroutine.send(None)
            except StopIteration:
                done()
                return
            if isinstance(waited_for, Sleeps):
                self._clock.loop.call_later(waited_for.seconds, enqueue, step)
            elif isinstance(waited_for, SimulatedFuture):
                waited_for.add_done_callback(lambda _: step())
            elif isinstance(waited_for, asyncio.Future):
                waited_for._asyncio_future_blocking = False
                waited_for.add_done_callback(lambda _: enqueue(step))
            else:
                enqueue(step)

        step()

    def pause(self, seconds: float) -> Awaitable[None]:
        return Sleeps(seconds)

    def create_publisher(self, topic: str, type_: type, qos: QoS) -> SimulatedWriter:
        return self._network.create_writer(self._process, topic, type_name(type_), qos)

    def create_subscription(
        self, topic: str, type_: type, qos: QoS, callback: Callable[[Any, Any], None]
    ) -> SimulatedReader:
        def take() -> None:
            if reader.queue and not reader.gone:
                callback(*reader.queue.popleft())

        process = self._process
        reader = self._network.create_reader(process, topic, type_name(type_), qos, lambda: process.enqueue(take))
        return reader

    def read_info(self, info: Any) -> MessageInfo:
        return MessageInfo(*info)

    def create_server(self, name: str, type_: type, answer: Callable[[Any, Any], Any]) -> SimulatedServer:
        if (server := taken_up(self._servers, name, type_, answer)) is None:
            end, gone = self._end(name, type_), partial(self._servers.pop, name, None)
            server = self._servers[name] = SimulatedServer(end, name, answer, self.admission, self._post, gone)
        return server

    def create_action_server(self, name: str, type_: type, answers: GoalAnswers) -> SimulatedActionServer:
        if (server := taken_up(self._action_servers, name, type_, answers)) is None:
            end, gone = self._end(name, type_), partial(self._action_servers.pop, name, None)
            server = SimulatedActionServer(end, name, answers, self.admission, self._post, gone)
            self._action_servers[name] = server
        return server

    def create_client(self, name: str, type_: type) -> SimulatedClient:
        return SimulatedClient(self._end(name, type_))

    def create_action_client(self, name: str, type_: type, accepted: Callable[[Any], None]) -> SimulatedActionClient:
        return SimulatedActionClient(self._end(name, type_), accepted)

    def _end(self, name: str, type_: type) -> ServiceEnd:
        return ServiceEnd(self._network.services, self._process, name, type_)

    def _post(self, work: Callable[[], Any]) -> None:
        """Have the data thread call ``work``, and drive it where it is async."""

        def call() -> None:
            result = work()
            if inspect.iscoroutine(result):
                self.run_coroutine(result, lambda: None)

        self._process.enqueue(call)

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> SimulatedTimer:
        return SimulatedTimer(self._clock, self._process.enqueue, round(period * 1e9), epoch, callback)

    # -- control thread --------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        if not self._process.runs:
            await self._process.wait_while_frozen()

    def publish_state(self, state: ComponentState) -> None:
        self._process.state = state

    def publish_diagnostics(self, entries: Callable[[], Sequence[DiagnosticEntry]]) -> None:
        self._process.diagnostics = entries

    def discovers(self, topic: str) -> bool | None:
        return self._network.shows_probe(self._process, topic)

    def extra_endpoints(self) -> list[Endpoint]:
        return []

    # -- the component's thread ------------------------------------------------------------------

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        async def control() -> None:
            await main()

        process, ended = self._process, threading.Event()
        process.main = task = self._clock.loop.create_task(control())
        task.add_done_callback(lambda _: process.enqueue(ended.set))
        if process.terminating:  # it was signalled while it started
            task.cancel()
        while not ended.is_set():
            process.run_work()
        if not task.cancelled() and (error := task.exception()) is not None:
            raise error
