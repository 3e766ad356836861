"""A component's process on ROS 1: see :class:`midstride.node.component_host.Host`.

rospy's own threads receive; the data thread runs user code; the main thread runs the event loop of the agent, which
also calls the master, so that a master that does not answer blocks nothing here. The agent answers its manager while
rospy is still joining ROS, which takes a tenth of a second.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import Any, Final, NoReturn, TypeVar

import msgspec
import rospy
from std_msgs.msg import String

from midstride.backends import common, diagnostic_array
from midstride.backends.naming import DIAGNOSTICS
from midstride.backends.ros1 import launching, names, node_parameters, publishing
from midstride.backends.ros1.data_thread import DataThread
from midstride.backends.ros1.master import Master
from midstride.backends.ros1.publishing import NumberedTopic, PortPublisher
from midstride.backends.ros1.registrar import Registrar, managers
from midstride.backends.ros1.subscribing import FramedTopic, PortSubscription
from midstride.backends.ros1.timers import Ros1GridTimer, RosClock
from midstride.errors import BackendError, NodeError
from midstride.model.contract import QoS
from midstride.model.instance_names import full_name, split_name
from midstride.node.clock_history import ClockHistory
from midstride.node.component_host import GoalAnswers, MessageInfo
from midstride.node.diagnostic_status import DiagnosticEntry
from midstride.node.process_context import find
from midstride.node.request_admission import RequestAdmission
from midstride.wire.environment import ENV_TOKEN
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

T = TypeVar("T")

# How long the end of each part may take (s): of the data thread, of the ports, and of rospy.
_DATA_THREAD_END: Final = 2.0
_PORTS_END: Final = 1.5
_ROSPY_END: Final = 2.0
# How long rospy's own shutdown waits for the component to end in order (s).
_ORDERLY_END: Final = _DATA_THREAD_END + _PORTS_END + 1.0
# A tool that subscribes late reads the latest states.
_LATCHED: Final = QoS(durability="transient_local", depth=10)


class Ros1Host:
    """Made and run in the thread that calls ``Component.start``. Raises NodeError where the name is taken.

    ``node``: the name of its node, where that is not the one of the instance.
    """

    ros_node: Any = rospy  # there, a process is one node
    has_services = False

    def __init__(self, name: str, namespace: str, node: str = "") -> None:
        managed = bool(os.environ.get(ENV_TOKEN))
        node_name, inside = split_name(node or name, namespace or rospy.names.get_namespace())
        given = [] if managed else [argument for argument in sys.argv[1:] if argument.startswith("__")]
        uri = launching.master_uri(os.environ)
        if launching.is_local(uri) and not os.environ.get("ROS_HOSTNAME"):
            os.environ.setdefault("ROS_IP", launching.LOOPBACK)
        self._arguments = given
        # A launch file may give another name to a component that no manager started.
        renamed = (argument.partition(":=")[2] for argument in given if argument.startswith("__name:="))
        self._node_name = next(renamed, node_name)
        self._node = full_name(self._node_name, inside)
        self.instance = (full_name(name, inside) if node else self._node).lstrip("/")
        # All instances of a role share the name of their diagnostics.
        self._role = full_name(find().node or self.instance, inside).lstrip("/")
        self._diagnostics: PortPublisher | None = None
        transport, self.reachable = common.control_transport(os.environ, sys.argv[1:])
        self.transport: Transport | None = transport
        self.managed = False
        self._master = Master(uri, self._node)
        asyncio.run(self._must_be_alone())
        self.logger: Any = logging.getLogger("rosout")
        self._data = DataThread(
            lambda failure: self.logger.error(f"a callback raised; the component keeps running:\n{failure}")
        )
        self.parameters = node_parameters.Ros1NodeParameters(managed, self._show_parameter)
        self._ended = threading.Event()
        self._shut_down_because = ""
        self.simulated_time = False
        self.clock_history = ClockHistory()
        self.publishes_ros_time = True
        self.now: Callable[[], int] = time.time_ns  # until rospy knows whether the clock is simulated
        self.steady: Callable[[], int] = time.monotonic_ns
        self.read_info: Callable[[Any], MessageInfo] = lambda info: MessageInfo(*info)
        # No service is behind it: here each instance has a node, and a node's services, under its own name.
        self.admission = RequestAdmission(self.steady, is_open=not find().standby)

    async def _must_be_alone(self) -> None:
        """Raises NodeError where the name is taken, BackendError where there is no master."""
        if await self._master.process(timeout=3.0) is None:
            raise BackendError(
                f"no ROS master answers at {self._master.uri}: start one with `roscore` or `rosmaster --core`, "
                "or have `midstride up --backend ros1` do so"
            )
        if await self._master.is_running(self._node):
            raise NodeError(
                f"a node {self._node} is running already; end it, or give this one another name "
                "(the master would end the first of two of one name)"
            )

    @property
    def node_name(self) -> str:
        return self._node

    def message_now(self) -> int:
        return self.now()

    # -- data thread ---------------------------------------------------------------------------------

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        return common.on_thread(function, self._data.post)

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        self._data.drive(coroutine, done)

    def pause(self, seconds: float) -> Awaitable[None]:
        return self._clock.pause(seconds)

    def create_publisher(self, topic: str, type_: type, qos: QoS) -> PortPublisher:
        return PortPublisher(topic, type_, qos, self.now, self._publishers)

    def create_subscription(
        self, topic: str, type_: type, qos: QoS, callback: Callable[[Any, Any], None]
    ) -> PortSubscription:
        return PortSubscription(topic, type_, qos, callback, self.now, self._data, self._subscribers)

    def create_server(self, name: str, type_: type, answer: Callable[[Any, Any], Any]) -> NoReturn:
        raise NodeError(f"{name}: ROS 1 has no services as ports")

    def create_action_server(self, name: str, type_: type, answers: GoalAnswers) -> NoReturn:
        raise NodeError(f"{name}: ROS 1 has no ROS actions as ports")

    def create_action_client(self, name: str, type_: type, accepted: Callable[[Any], None]) -> NoReturn:
        raise NodeError(f"{name}: ROS 1 has no ROS actions as ports")

    def create_client(self, name: str, type_: type) -> NoReturn:
        raise NodeError(f"{name}: ROS 1 has no services as ports")

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Ros1GridTimer:
        return Ros1GridTimer(self._clock, period, epoch, callback)

    # -- control thread ------------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    def publish_state(self, state: ComponentState) -> None:
        self._states.publish(String(msgspec.json.encode(state).decode()))

    def publish_diagnostics(self, entries: Callable[[], Sequence[DiagnosticEntry]]) -> None:
        if diagnostic_array.MESSAGE is None:
            return
        if self._diagnostics is None:
            try:
                self._diagnostics = PortPublisher(
                    DIAGNOSTICS, diagnostic_array.MESSAGE, QoS(), self.now, self._publishers
                )
            except NodeError:
                return  # user code publishes there without a port
        if self._diagnostics.matched() > 0:
            self._diagnostics.publish(diagnostic_array.message(entries(), self._role, self.instance, self.now()))

    def discovers(self, topic: str) -> bool | None:
        return None  # the master does it

    def extra_endpoints(self) -> list[Endpoint]:
        return node_parameters.endpoints()

    def _show_parameter(self, name: str, value: Any) -> None:
        """On the data thread, which does not wait for the parameter server."""

        async def show() -> None:
            with contextlib.suppress(BackendError):
                await self._master.call("setParam", self._node, f"{self._node}/{name}", value)

        asyncio.run_coroutine_threadsafe(show(), self._loop)

    # -- life ----------------------------------------------------------------------------------------

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        try:
            asyncio.run(self._run(main))
        finally:
            self._leave()
        if self._shut_down_because:
            self.logger.warning(f"{self.instance} was shut down {self._shut_down_because}")

    async def _run(self, main: Callable[[], Awaitable[None]]) -> None:
        self._loop = asyncio.get_running_loop()
        task = asyncio.ensure_future(main())  # it answers its manager, and waits for the data thread
        opened = False
        with common.ending_on_signals(task) as signals:
            joining = asyncio.ensure_future(common.on_new_thread(self._join))
            try:
                await asyncio.wait({task, joining}, return_when=asyncio.FIRST_COMPLETED)
                if joining.done() and not signals:
                    joining.result()
                    self._open(task)
                    opened = True
                await task
            except asyncio.CancelledError:
                if not signals and not self._shut_down_because:
                    raise
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)
                if opened:
                    await self._close()

    def _join(self) -> None:
        """Join ROS. In a thread: rospy waits for the master, without a deadline."""
        rospy.init_node(self._node_name, argv=[sys.argv[0], *self._arguments], disable_signals=True)
        publishing.prepare()
        self._node = rospy.get_name()
        self._clock = RosClock(self._data)
        self.now, self.simulated_time = self._clock.now, self._clock.simulated
        self.clock_history = self._clock.history
        common.with_short_pauses()

    def _open(self, main: asyncio.Future[None]) -> None:
        """The node has joined: create its topics, and start the data thread."""
        loop, uri = self._loop, rospy.core.get_node_uri()
        self._publishers: Registrar[NumberedTopic] = Registrar("Publisher", self._master, self._node, uri, loop)
        self._subscribers: Registrar[FramedTopic] = Registrar("Subscriber", self._master, self._node, uri, loop)
        self._states = PortPublisher(names.STATE, String, _LATCHED, self.now, self._publishers)
        rospy.core.add_client_shutdown_hook(lambda: self._shut_down_by_others(loop, main))
        self._data.start()

    async def _close(self) -> None:
        self._states.destroy()
        if self._diagnostics is not None:
            self._diagnostics.destroy()
        await asyncio.gather(self._publishers.end(_PORTS_END), self._subscribers.end(_PORTS_END))
        with contextlib.suppress(BackendError):  # they are this instance's: the next one of its name must not find them
            for name in self.parameters.values:
                await self._master.call("deleteParam", self._node, f"{self._node}/{name}", timeout=0.5)

    def _shut_down_by_others(self, loop: asyncio.AbstractEventLoop, main: asyncio.Future[None]) -> None:
        """rospy shuts down (`rosnode kill`, or another node of the name came up): end in order first."""
        if self._ended.is_set() or loop.is_closed():
            return
        self._shut_down_because = "by `rosnode kill`, or by the master, because another node of its name came up"
        loop.call_soon_threadsafe(main.cancel)
        self._ended.wait(_ORDERLY_END)

    def _leave(self) -> None:
        """User code ends first, then rospy, which calls the master; each in bounded time."""
        self._ended.set()
        if not self._data.stop(_DATA_THREAD_END):
            self.logger.error(f"user code has not returned for {_DATA_THREAD_END:g} s; the process ends all the same")
        connecting = managers()
        leaving = threading.Thread(target=rospy.signal_shutdown, args=("the component has ended",), daemon=True)
        leaving.start()
        deadline = time.monotonic() + _ROSPY_END
        while leaving.is_alive() and time.monotonic() < deadline:
            for manager in connecting:  # rospy waits for its thread, which looks twice a second whether to end
                with manager.cond:
                    manager.cond.notify_all()
            leaving.join(0.01)
