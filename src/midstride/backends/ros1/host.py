"""A component's process on ROS 1: see :class:`midstride.node.host.Host`.

rospy's own threads receive; one thread, the data side, runs user code; the main thread runs the event
loop of the agent, the control side, which also speaks to the master, so that whoever does not answer
there holds up nothing here.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Final, TypeVar

import rospy
from std_msgs.msg import String

from midstride.backends import common
from midstride.backends.ros1 import launching, names, node_parameters, publishing, subscribing
from midstride.backends.ros1.command_client import Caller
from midstride.backends.ros1.command_server import CommandServer
from midstride.backends.ros1.data_thread import DataThread
from midstride.backends.ros1.master import Master
from midstride.backends.ros1.publishing import NumberedTopic, PortPublisher
from midstride.backends.ros1.registrar import Registrar, managers
from midstride.backends.ros1.subscribing import FramedTopic, PortSubscription
from midstride.backends.ros1.timers import Ros1GridTimer, RosClock
from midstride.errors import BackendError, NodeError
from midstride.model.contract import QoS
from midstride.node.host import MessageInfo
from midstride.wire.environment import ENV_TOKEN, Announcement, Command, Reply

T = TypeVar("T")

# How long the data side may take to let go at the end, the control side to give its last answers, ports to be given
# up, and rospy to leave (s).
_JOIN: Final = 2.0
_LAST_ANSWERS: Final = 1.0
_GIVE_UP: Final = 1.5
_LEAVE: Final = 2.0
# What came late is told again to a reader that is later still; nothing of Midstride's own relies on more.
_LATCHED: Final = QoS(durability="transient_local", depth=10)


class Ros1Host:
    """Made and run in the thread that calls ``Component.start``. Raises NodeError where the name is taken."""

    backend = "ros1"

    def __init__(self, name: str, namespace: str) -> None:
        managed = bool(os.environ.get(ENV_TOKEN))
        node_name, inside = names.split(name, namespace or rospy.names.get_namespace())
        given = [] if managed else [argument for argument in sys.argv[1:] if argument.startswith("__")]
        uri = launching.master_uri(os.environ)
        if launching.is_local(uri) and not os.environ.get("ROS_HOSTNAME"):
            os.environ.setdefault("ROS_IP", launching.LOOPBACK)
        self._node = names.full(_named(given, node_name), inside)
        self.instance = self._node.lstrip("/")
        self._master = Master(uri, self._node)
        asyncio.run(self._must_be_alone())
        rospy.init_node(_named(given, node_name), argv=[sys.argv[0], *given], disable_signals=True)
        publishing.prepare()
        self._node = rospy.get_name()
        self._logger = logging.getLogger("rosout")
        self._data = DataThread(
            lambda told: self._logger.error(f"a callback raised, and the component goes on:\n{told}")
        )
        self._clock = RosClock(self._data)
        self._parameters = node_parameters.Ros1NodeParameters(managed, self._show_parameter)
        self._ended = threading.Event()
        self._told_to_end = ""
        self.now: Callable[[], int] = self._clock.now
        self.steady: Callable[[], int] = time.monotonic_ns
        self.read_info: Callable[[Any], MessageInfo] = subscribing.read_info

    async def _must_be_alone(self) -> None:
        """Raises NodeError where the name is taken, BackendError where there is no master."""
        if await self._master.process(timeout=3.0) is None:
            raise BackendError(
                f"no ROS master answers at {self._master.uri}: start one with `roscore` or `rosmaster --core`, "
                "or have `midstride up --backend ros1` do so"
            )
        if await self._master.holder(self._node):
            raise NodeError(
                f"a node {self._node} is running already; end it, or give this one another name "
                "(the master would end the first of two of one name)"
            )

    # -- data side -----------------------------------------------------------------------------------

    @property
    def logger(self) -> Any:
        return self._logger

    @property
    def ros_node(self) -> Any:
        """rospy itself: there, a process is one node."""
        return rospy

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        return self._data.run(function)

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

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Ros1GridTimer:
        return Ros1GridTimer(self._clock, period, epoch, callback)

    # -- control side --------------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def call_peer(self, instance: str, command: Command, timeout: float) -> Reply:
        return await self._caller.call(names.command_service(names.full(instance)), command, timeout)

    def announce(self, announcement: Announcement) -> None:
        self._announcements.publish(String(announcement.to_json()))

    def publish_state(self, state: dict[str, Any]) -> None:
        self._states.publish(String(json.dumps(state)))

    def extra_endpoints(self) -> list[dict[str, str]]:
        return node_parameters.endpoints()

    def parameter(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        return self._parameters.declare(name, default, on_change)

    def set_parameters(self, values: dict[str, Any]) -> None:
        self._parameters.set(values)

    def _show_parameter(self, name: str, value: Any) -> None:
        """On the data side: the parameter server may take its time."""

        async def show() -> None:
            with contextlib.suppress(BackendError):
                await self._master.ask("setParam", self._node, f"{self._node}/{name}", value)

        asyncio.run_coroutine_threadsafe(show(), self._loop)

    # -- life ----------------------------------------------------------------------------------------

    def run(self, main: Callable[[], Awaitable[None]], serve: Callable[[Command], Awaitable[Reply]]) -> None:
        common.with_short_pauses()
        try:
            asyncio.run(self._run(main, serve))
        finally:
            self._leave()
        if self._told_to_end:
            self._logger.warning(f"{self.instance} was told to end: {self._told_to_end}")

    async def _run(self, main: Callable[[], Awaitable[None]], serve: Callable[[Command], Awaitable[Reply]]) -> None:
        self._loop = loop = asyncio.get_running_loop()
        uri = rospy.core.get_node_uri()
        self._caller = Caller(self._master)
        self._publishers: Registrar[NumberedTopic] = Registrar("Publisher", self._master, self._node, uri, loop)
        self._subscribers: Registrar[FramedTopic] = Registrar("Subscriber", self._master, self._node, uri, loop)
        self._announcements = PortPublisher(names.ANNOUNCEMENT, String, QoS(depth=1), self.now, self._publishers)
        self._states = PortPublisher(names.STATE, String, _LATCHED, self.now, self._publishers)
        self._data.start()
        task = asyncio.ensure_future(main())
        door = CommandServer(self._node, serve)
        rospy.core.add_client_shutdown_hook(lambda: self._shut_down_by_others(loop, task))
        try:
            with common.ending_on_signals(task) as interrupted:
                try:
                    await task
                except asyncio.CancelledError:
                    if not interrupted and not self._told_to_end:
                        raise
        finally:
            await door.answered(_LAST_ANSWERS)
            for publisher in (self._announcements, self._states):
                publisher.destroy()
            await asyncio.gather(self._publishers.end(_GIVE_UP), self._subscribers.end(_GIVE_UP))
            await self._take_down_parameters()

    async def _take_down_parameters(self) -> None:
        """They are of this instance; the next one of its name is not to find them."""
        with contextlib.suppress(BackendError):
            for name in self._parameters.names():
                await self._master.ask("deleteParam", self._node, f"{self._node}/{name}", timeout=0.5)

    def _shut_down_by_others(self, loop: asyncio.AbstractEventLoop, main: asyncio.Future[None]) -> None:
        """rospy was told to shut down (`rosnode kill`, or another node of the name came up): end in order first."""
        if self._ended.is_set() or loop.is_closed():
            return
        self._told_to_end = "by `rosnode kill`, or by the master for the sake of another node of its name"
        loop.call_soon_threadsafe(main.cancel)
        self._ended.wait(_JOIN + _LAST_ANSWERS + _GIVE_UP)

    def _leave(self) -> None:
        """User code first, then rospy, which tells the master; neither may hold the process for long."""
        self._ended.set()
        if not self._data.stop(_JOIN):
            self._logger.error(f"user code has not returned for {_JOIN:g} s; the process leaves without it")
        connecting = managers()
        leaving = threading.Thread(target=rospy.signal_shutdown, args=("the component has ended",), daemon=True)
        leaving.start()
        deadline = time.monotonic() + _LEAVE
        while leaving.is_alive() and time.monotonic() < deadline:
            for manager in connecting:  # it looks twice a second whether it is over, and rospy waits for that
                with manager.cond:
                    manager.cond.notify_all()
            leaving.join(0.01)


def _named(given: list[str], name: str) -> str:
    """The node's name: a launch file may give another one to a component that nobody manages."""
    return next((argument.partition(":=")[2] for argument in given if argument.startswith("__name:=")), name)
