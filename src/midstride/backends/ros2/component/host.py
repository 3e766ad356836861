"""A component's process on ROS 2: see :class:`midstride.node.component_host.Host`.

The main thread runs the asyncio loop of the agent, so that signals are dealt with in Python's own way and commands are
answered before ROS has been joined; what needs ROS waits until the nodes exist (:mod:`.node_threads`). Whatever changes
endpoints is a task of the data executor.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeVar
from weakref import WeakSet

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockChange, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.logging import get_logger
from rclpy.task import Future

from midstride.backends.common import control_transport, ending_on_signals, on_thread, with_short_pauses
from midstride.backends.retiring_server import taken_up
from midstride.backends.ros2 import middleware, names
from midstride.backends.ros2.component import node_parameters, port_endpoints
from midstride.backends.ros2.component.node_threads import ComponentNodes
from midstride.backends.ros2.component.parameter_services import parameters_of
from midstride.backends.ros2.component.service_endpoints import RosClient, RosServer
from midstride.backends.ros2.component.timers import Ros2GridTimer, SetBackWatch
from midstride.model.contract import QoS
from midstride.model.instance_names import dotted_name, full_name, split_name
from midstride.node import process_context
from midstride.node.clock_history import ClockHistory
from midstride.node.component_host import GoalAnswers, MessageInfo, NodeParameters
from midstride.node.diagnostic_status import DiagnosticEntry
from midstride.node.request_admission import RequestAdmission
from midstride.wire.environment import ENV_SHARED_NAME, ENV_TOKEN
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

if TYPE_CHECKING:  # imported where there is a ROS action
    from midstride.backends.ros2.component.action_endpoints import RosActionClient, RosActionServer

T = TypeVar("T")

# How often the host checks that the component can go on (s), at first and later: each check wakes an idle process.
# A signal that Python missed is noticed by then.
_CHECK_AT_FIRST: Final = 0.1
_CHECK: Final = 1.0


class Ros2Host:
    """Created and run in the thread that calls ``Component.start``; joins ROS in :meth:`run`."""

    has_services = True

    def __init__(self, name: str, namespace: str) -> None:
        self.instance = name
        context = process_context.find()
        self._instance, self._namespace = split_name(name, namespace)
        self._name, _ = split_name(context.node or name, namespace)
        transport, self.reachable = control_transport(os.environ, sys.argv[1:])
        self.transport: Transport | None = transport
        self.managed = False
        self.logger: Any = get_logger(dotted_name(self.node_name))
        self._context = context
        self._nodes: ComponentNodes | None = None
        self._ports: set[int] = set()
        self._servers: dict[str, RosServer] = {}  # those in the graph, by name
        self._action_servers: dict[str, RosActionServer] = {}  # likewise
        self._timers: WeakSet[Ros2GridTimer] = WeakSet()
        self.simulated_time = False
        self._failure: Exception | None = None
        # What is to run on the data thread once there is one.
        self._early: list[Callable[[], None]] = []
        self._post: Callable[[Callable[[], None]], object] = self._early.append
        self.steady: Callable[[], int] = time.monotonic_ns
        self.message_now: Callable[[], int] = time.time_ns  # the middleware stamps with the system's clock
        self.publishes_ros_time = False
        self.clock_history = ClockHistory()
        self._rmw = middleware.of_this_process()
        self.read_info: Callable[[Any], MessageInfo] = self._rmw.message_info
        self.admission = RequestAdmission(self.steady, is_open=not context.standby)

    @property
    def node_name(self) -> str:
        return full_name(self._name, self._namespace)

    # -- time ----------------------------------------------------------------------------------------

    def now(self) -> int:
        # Without a simulation the ROS clock is the system's, and asking Python for that is cheaper by far.
        return int(self._clock.now().nanoseconds) if self.simulated_time else time.time_ns()

    def _clock_moved(self, jump: Any) -> None:
        """``/clock`` has moved the ROS clock, or begun or ceased to drive it."""
        if jump.clock_change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED):
            self.simulated_time = bool(self._clock.ros_time_is_active)
            self.clock_history.clear()
        elif self.simulated_time:
            self.clock_history.add(self.steady(), self.now())

    def _follow_clock(self) -> None:
        """On the data thread: the system's clock has been set back."""
        for timer in list(self._timers):
            timer.follow_clock()

    # -- data thread -----------------------------------------------------------------------------------

    def on_data(self, function: Callable[[], T]) -> Awaitable[T]:
        return on_thread(function, self._post)

    def run_coroutine(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        async def drive() -> None:
            await coroutine
            done()

        self._executor.create_task(drive)

    def pause(self, seconds: float) -> Awaitable[None]:
        future = Future(executor=self._executor)

        def over() -> None:
            timer.cancel()
            self.ros_node.destroy_timer(timer)
            future.set_result(None)

        clock = self._clock if self.simulated_time else self._steady_clock  # rcl does not notice that one is set back
        timer = self.ros_node.create_timer(max(0.0, seconds), over, callback_group=self._group, clock=clock)
        return future  # type: ignore[no-any-return]

    def create_publisher(self, topic: str, type_: type, qos: QoS) -> port_endpoints.RosPublisher:
        message_type, _ = port_endpoints.message_type_of(type_)
        profile = port_endpoints.profile_of(qos)
        publisher = self.ros_node.create_publisher(message_type, topic, profile, callback_group=self._group)
        self._ports.add(id(publisher))
        return port_endpoints.RosPublisher(
            publisher,
            qos,
            self._rmw,
            self._destroy(self.ros_node.destroy_publisher),
            self.ros_node.get_subscriptions_info_by_topic,
        )

    def create_subscription(
        self, topic: str, type_: type, qos: QoS, callback: Callable[[Any, Any], None]
    ) -> port_endpoints.RosSubscription:
        message_type, raw = port_endpoints.message_type_of(type_)
        receive = (lambda message, info: callback(type_(message), info)) if raw else callback
        subscription = self.ros_node.create_subscription(
            message_type,
            topic,
            port_endpoints.for_rclpy(receive),
            port_endpoints.profile_of(qos),
            callback_group=self._group,
            raw=raw,
        )
        self._ports.add(id(subscription))
        return port_endpoints.RosSubscription(
            subscription,
            self._rmw,
            self._destroy(self.ros_node.destroy_subscription),
            self.ros_node.get_publishers_info_by_topic,
        )

    def create_server(self, name: str, type_: type, answer: Callable[[Any, Any], Any]) -> RosServer:
        if (server := taken_up(self._servers, name, type_, answer)) is not None:
            return server
        server = RosServer(
            self.ros_node,
            self._group,
            name,
            type_,
            answer,
            admission=self.admission,
            later=self._post,
            gone=self._has_left,
        )
        self._servers[name] = server
        self._ports.add(id(server.service))
        return server

    def create_action_server(self, name: str, type_: type, answers: GoalAnswers) -> RosActionServer:
        from midstride.backends.ros2.component.action_endpoints import RosActionServer

        if (server := taken_up(self._action_servers, name, type_, answers)) is not None:
            return server
        server = self._action_servers[name] = RosActionServer(
            self.ros_node,
            self._group,
            name,
            type_,
            answers,
            admission=self.admission,
            later=self._post,
            gone=lambda server: self._action_servers.pop(server.name, None),
        )
        return server

    def create_action_client(self, name: str, type_: type, accepted: Callable[[Any], None]) -> RosActionClient:
        from midstride.backends.ros2.component.action_endpoints import RosActionClient

        return RosActionClient(self.ros_node, self._group, name, type_, accepted)

    def _has_left(self, server: RosServer) -> None:
        self._ports.discard(id(server.service))
        if self._servers.get(server.name) is server:
            del self._servers[server.name]

    def create_client(self, name: str, type_: type) -> RosClient:
        client = RosClient(self.ros_node, self._group, name, type_, self._destroy(self.ros_node.destroy_client))
        self._ports.add(id(client.client))
        return client

    def leave_out(self, endpoint: Any) -> None:
        """Leave ``endpoint``, one of Midstride's own, out of :meth:`extra_endpoints`."""
        self._ports.add(id(endpoint))

    def _destroy(self, destroy: Callable[[Any], object]) -> Callable[[Any], None]:
        def destroyed(endpoint: Any) -> None:
            self._ports.discard(id(endpoint))
            destroy(endpoint)

        return destroyed

    def create_timer(self, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Ros2GridTimer:
        timer = Ros2GridTimer(self.ros_node, self._group, self.now, period, epoch, callback)
        self._timers.add(timer)
        return timer

    # -- control thread --------------------------------------------------------------------------------

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    def publish_state(self, state: ComponentState) -> None:
        if self._nodes is not None:
            self._nodes.parameter_services.show(parameters_of(state), self.now(), publish=state.answers)

    def publish_diagnostics(self, entries: Callable[[], Sequence[DiagnosticEntry]]) -> None:
        if self._nodes is not None:
            self._nodes.diagnostics.publish(entries, self.now())

    def discovers(self, topic: str) -> bool | None:
        # From the graph that rmw keeps: it does not wait for a middleware that has deadlocked.
        return self._nodes is not None and self.ros_node.count_publishers(topic) > 0

    def extra_endpoints(self) -> list[Endpoint]:
        if (nodes := self._nodes) is None:
            return []
        return node_parameters.endpoints(self.ros_node, nodes.control_name, self._ports, self._rmw)

    # -- life ----------------------------------------------------------------------------------------

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        try:
            asyncio.run(self._run(main))
        finally:
            self._leave()
        if self._failure is not None:
            raise self._failure

    async def _run(self, main: Callable[[], Awaitable[None]]) -> None:
        task = asyncio.ensure_future(main())  # opens the control socket, then waits for the data thread
        with ending_on_signals(task) as signals:
            watch = asyncio.ensure_future(self._join_and_watch(task))
            try:
                await task
            except asyncio.CancelledError:
                if not signals and self._failure is None:
                    raise
            finally:
                watch.cancel()

    async def _join_and_watch(self, main: asyncio.Future[None]) -> None:
        """Join ROS, then check now and then that the component can go on; where it cannot, end ``main``."""
        try:
            nodes = await asyncio.to_thread(self._join)
            with_short_pauses()
            self._post = self._executor.create_task
            for function in self._early:
                self._post(function)
            set_back_watch = SetBackWatch()
            while True:
                starting = nodes.check(managed=self.managed)
                await asyncio.sleep(_CHECK_AT_FIRST if starting else _CHECK)
                if set_back_watch.was_set_back() and not self.simulated_time:
                    self._post(self._follow_clock)
        except Exception as error:
            self._failure = error
            main.cancel()

    def _join(self) -> ComponentNodes:
        """Not on the loop's thread, which serves commands meanwhile."""
        nodes = ComponentNodes(
            self._instance,
            self._name,
            self._namespace,
            admission=self.admission,
            system=names.system_tag(os.environ.get(ENV_TOKEN, "")),
            shares_name=bool(os.environ.get(ENV_SHARED_NAME)),
            # The node gets all that the manager gave, for ROS itself has parameters (``use_sim_time``).
            parameters=self._context.parameters,
            set_parameters=self._context.set_parameters,
            failed=lambda raised: self.logger.error(
                f"a callback raised; the component keeps running without it:\n{raised}"
            ),
        )
        self.ros_node: Any = nodes.data
        self._name, self._namespace = nodes.data.get_name(), nodes.data.get_namespace()
        self._executor = nodes.data_executor
        self._group = ReentrantCallbackGroup()
        self.parameters: NodeParameters = node_parameters.Ros2NodeParameters(
            self.ros_node, {**self._context.parameters, **self._context.set_parameters}
        )
        self._clock = self.ros_node.get_clock()
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.simulated_time = bool(self._clock.ros_time_is_active)
        any_move = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._clock_changes = self._clock.create_jump_callback(any_move, post_callback=self._clock_moved)
        self.logger = self.ros_node.get_logger()
        self._nodes = nodes
        return nodes

    def _leave(self) -> None:
        if self._nodes is None:
            return
        self._clock_changes.unregister()
        if not self._nodes.leave():
            self.logger.error("user code has not returned; exiting without waiting for it")
