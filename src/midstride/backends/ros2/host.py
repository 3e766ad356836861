"""A component's process on ROS 2: see :class:`midstride.node.host.Host`.

Three threads (platform.md): the main one runs the asyncio loop of the agent, so that signals are
dealt with in Python's own way; one spins the executor of the *data* node, which bears the instance's
name and runs user code; one spins that of a hidden *control* node, which answers for the component
while user code runs. Whatever changes endpoints is a task of the data executor.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Final, TypeVar

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import JumpThreshold
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from midstride.backends.common import ending_on_signals, on_thread, with_short_pauses
from midstride.backends.ros2 import endpoints, events, names, node_parameters, qos
from midstride.backends.ros2.command_client import Caller
from midstride.backends.ros2.executor_thread import ExecutorThread
from midstride.backends.ros2.parameter_services import ParameterServices, parameters_of
from midstride.backends.ros2.timers import Ros2GridTimer
from midstride.errors import NodeError
from midstride.model.contract import QoS
from midstride.node.host import MessageInfo
from midstride.wire.environment import ENV_PARAMETERS, ENV_TOKEN, Announcement, Command, Reply

T = TypeVar("T")

# A node that a manager started looks for another one of its name after it has joined; one that was
# started by hand looks before (s). Who looks longer starts later.
_LOOK: Final = 0.5
# What nobody asks for is done this often (s): a signal that came in the middle of something is seen by then.
_HEARTBEAT: Final = 0.1
# How long the data side may take to let go at the end, and the control side to give its last answers (s).
_JOIN: Final = 2.0
_LAST_ANSWERS: Final = 1.0


class Ros2Host:
    """Made and run in the thread that calls ``Component.start``. Raises NodeError where the name is taken."""

    backend = "ros2"

    def __init__(self, name: str, namespace: str) -> None:
        self.instance = name
        managed = bool(os.environ.get(ENV_TOKEN))
        node_name, inside = names.split(name, namespace)
        self._own_context = not rclpy.ok()
        if self._own_context:
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        self._context = rclpy.utilities.get_default_context()
        self._control_node = Node(
            names.control(node_name),
            namespace=inside,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._full_name = names.full(node_name, inside)
        try:
            self._must_be_alone(time.monotonic() + (0.0 if managed else _LOOK), others=0)
        except NodeError:
            self._leave_ros()
            raise
        given = _given_parameters()
        pinned = ["--ros-args", "-r", f"__node:={node_name}", "-r", f"__ns:={inside}"] if managed else None
        self._data_node = Node(
            node_name,
            namespace=inside,
            cli_args=pinned,
            start_parameter_services=False,
            parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
        )
        self._full_name = self._data_node.get_fully_qualified_name()
        self._data = ExecutorThread("midstride-data", self._context, self._tell)
        self._control = ExecutorThread("midstride-control", self._context, self._tell)
        self._data.executor.add_node(self._data_node)
        self._control.executor.add_node(self._control_node)
        self._data_group = ReentrantCallbackGroup()
        self._control_group = ReentrantCallbackGroup()
        self._events = events.publisher(self._control_node)
        self._caller = Caller(self._control_node, self._control.executor, self._control_group)
        self._parameters = node_parameters.Ros2NodeParameters(self._data_node, given)
        self._ports: set[int] = set()
        self._door: ParameterServices | None = None
        self._shown: dict[str, Any] = {}
        self._failure: NodeError | None = None
        self._clock = self._data_node.get_clock()
        self._simulated = bool(self._clock.ros_time_is_active)
        self._clock_changes = self._clock.create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=None, on_clock_change=True), post_callback=self._clock_changed
        )
        self.steady: Callable[[], int] = time.monotonic_ns
        self.read_info: Callable[[Any], MessageInfo] = endpoints.read_info

    # -- time ----------------------------------------------------------------------------------------

    def now(self) -> int:
        # Without a simulation the ROS clock is the system's, and asking Python for that is cheaper by far.
        return int(self._clock.now().nanoseconds) if self._simulated else time.time_ns()

    def _clock_changed(self, jump: Any) -> None:
        self._simulated = bool(self._clock.ros_time_is_active)

    # -- data side -----------------------------------------------------------------------------------

    @property
    def logger(self) -> Any:
        return self._data_node.get_logger()

    @property
    def ros_node(self) -> Any:
        return self._data_node

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        return on_thread(function, self._data.executor.create_task)

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        async def drive() -> None:
            await coroutine
            done()

        self._data.executor.create_task(drive)

    def pause(self, seconds: float) -> Awaitable[None]:
        future = Future(executor=self._data.executor)

        def over() -> None:
            timer.cancel()
            self._data_node.destroy_timer(timer)
            future.set_result(None)

        timer = self._data_node.create_timer(max(0.0, seconds), over, callback_group=self._data_group)
        return future  # type: ignore[no-any-return]

    def create_publisher(self, topic: str, type_: type, qos_: QoS) -> endpoints.RosPublisher:
        publisher = self._data_node.create_publisher(type_, topic, qos.profile(qos_), callback_group=self._data_group)
        self._ports.add(id(publisher))
        return endpoints.RosPublisher(publisher, qos_, self._destroy(self._data_node.destroy_publisher))

    def create_subscription(
        self, topic: str, type_: type, qos_: QoS, callback: Callable[[Any, Any], None]
    ) -> endpoints.RosSubscription:
        subscription = self._data_node.create_subscription(
            type_, topic, endpoints.for_rclpy(callback), qos.profile(qos_), callback_group=self._data_group
        )
        self._ports.add(id(subscription))
        return endpoints.RosSubscription(
            subscription, self._destroy(self._data_node.destroy_subscription), self._data_node.count_publishers
        )

    def _destroy(self, destroy: Callable[[Any], object]) -> Callable[[Any], None]:
        def forget(endpoint: Any) -> None:
            self._ports.discard(id(endpoint))
            destroy(endpoint)

        return forget

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Ros2GridTimer:
        return Ros2GridTimer(self._data_node, self._data_group, self.now, period, epoch, callback)

    # -- control side --------------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def call_peer(self, instance: str, command: Command, timeout: float) -> Reply:
        return await self._caller.call(names.full(instance), command, timeout)

    def announce(self, announcement: Announcement) -> None:
        self._show({names.ANNOUNCEMENT: announcement.to_json()}, again=True)

    def publish_state(self, state: dict[str, Any]) -> None:
        self._show(parameters_of(state), again=False)

    def _show(self, values: dict[str, Any], again: bool) -> None:
        """Parameters to be read from now on; those that changed, or all, are told on ``/parameter_events``."""
        told = values if again else {name: value for name, value in values.items() if self._shown.get(name) != value}
        self._shown = {**self._shown, **values}
        if self._door is not None:
            self._door.show(self._shown)
        if told:
            self._events.publish(events.changed(self._full_name, self.now(), told))

    def extra_endpoints(self) -> list[dict[str, str]]:
        return node_parameters.endpoints(self._data_node, self._ports)

    def parameter(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        return self._parameters.declare(name, default, on_change)

    def set_parameters(self, values: dict[str, Any]) -> None:
        self._parameters.set(values)

    # -- life ----------------------------------------------------------------------------------------

    def run(self, main: Callable[[], Awaitable[None]], serve: Callable[[Command], Awaitable[Reply]]) -> None:
        with_short_pauses()
        try:
            asyncio.run(self._run(main, serve))
        finally:
            self._leave()
        if self._failure is not None:
            raise self._failure

    async def _run(self, main: Callable[[], Awaitable[None]], serve: Callable[[Command], Awaitable[Reply]]) -> None:
        self._door = ParameterServices(
            self._control_node, self._data_node, self._control_group, self._control.executor, serve, self.on_data
        )
        self._door.show(self._shown)
        self._data.start()
        self._control.start()
        task = asyncio.ensure_future(main())
        heartbeat = asyncio.ensure_future(self._beat(task))
        with ending_on_signals(task) as signals:
            try:
                await task
            except asyncio.CancelledError:
                if not signals and self._failure is None:
                    raise
            finally:
                heartbeat.cancel()
                await self._door.answered(_LAST_ANSWERS)

    async def _beat(self, main: asyncio.Future[None]) -> None:
        """Keeps the loop awake for signals, and looks whether the component can go on; where not, ends ``main``."""
        looking_until = time.monotonic() + _LOOK
        while True:
            try:
                if not self._context.ok():
                    raise NodeError("rclpy was shut down from within the component; leave that to start()")
                if time.monotonic() < looking_until:
                    self._must_be_alone(0.0, others=1)
            except NodeError as error:
                self._failure = error
                main.cancel()
                return
            await asyncio.sleep(_HEARTBEAT)

    def _must_be_alone(self, deadline: float, others: int) -> None:
        """Raises NodeError where more than ``others`` nodes of our name are in the graph by ``deadline``."""
        while True:
            seen = [names.full(name, inside) for name, inside in self._control_node.get_node_names_and_namespaces()]
            if seen.count(self._full_name) > others:
                raise NodeError(
                    f"a node {self._full_name} is running already; end it, or give this one another name "
                    "(two of one name would both answer)"
                )
            if time.monotonic() >= deadline:
                return
            time.sleep(0.02)

    def _tell(self, failure: str) -> None:
        self.logger.error(f"a callback raised, and the component goes on without it:\n{failure}")

    def _leave(self) -> None:
        """Threads first, then the nodes, then ROS: any other order aborts the process."""
        control_left = self._control.stop(_JOIN)
        data_left = self._data.stop(_JOIN)
        self._clock_changes.unregister()
        if not data_left:
            self.logger.error(f"user code has not returned for {_JOIN:g} s; the process leaves without it")
        if control_left and data_left:
            self._data_node.destroy_node()
            self._leave_ros()
        elif self._own_context:
            self._context.try_shutdown()

    def _leave_ros(self) -> None:
        self._control_node.destroy_node()
        if self._own_context:
            self._context.try_shutdown()


def _given_parameters() -> dict[str, Any]:
    """What the manager gave. The node is told of all of it, for ROS has parameters of its own (``use_sim_time``)."""
    text = os.environ.get(ENV_PARAMETERS)
    return dict(json.loads(text)) if text else {}
