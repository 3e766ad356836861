"""The manager's side on ROS 2: see :class:`midstride.runtime.backend.Backend`.

One hidden node in a context of its own, spun by a thread of its own; everything else happens on the
manager's event loop. Components are processes (:mod:`midstride.runtime.process`), so an exit is known
at once; the graph, which is slower, is asked for what it alone knows.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from midstride.backends import common
from midstride.backends.common import Children
from midstride.backends.ros2 import dds_profiles, events, launching, names
from midstride.backends.ros2.command_client import Caller
from midstride.backends.ros2.executor_thread import ExecutorThread
from midstride.errors import BackendError, StartFailed, Unreachable
from midstride.runtime.backend import Endpoints, Exited, Handle, Launch
from midstride.runtime.clock import Clock, SystemClock
from midstride.runtime.process import Process, find, spawn
from midstride.runtime.reaper import Reaper
from midstride.wire.environment import ENV_INSTANCE, Announcement, Command, Reply

# A manager that has just joined knows nobody yet: that long it listens before it says that a name is free (s).
_LISTEN: Final = 0.3
# How long the name of a process that has ended may stay in the graph: the lease of the tuned discovery and a bit (s).
_LINGER: Final = 5.0
# How long a component of an earlier manager may take to be found in the graph (s): news that is lost on a busy machine
# comes again after 3 s.
_FIND: Final = 15.0
_JOIN: Final = 2.0
_POLL: Final = 0.02


class Ros2Backend:
    """To be opened, used and closed on one event loop."""

    name = "ros2"

    def __init__(
        self,
        *,
        logs: Path | None = None,
        guardian: Reaper | None = None,
        tuned: bool = True,
        use_sim_time: bool = False,
    ) -> None:
        self._own_clock = Ros2Clock()
        self.clock: Clock = self._own_clock
        self.tuning = dds_profiles.Tuning("", untuned=("discovery: left as it comes, as it was asked for",))
        self._logs = logs
        self._tuned = tuned
        self._use_sim_time = use_sim_time
        self._children = Children(guardian, self._exited)
        self._ended: dict[str, float] = {}
        self._opened = 0.0
        self._context: Any = None

    # -- joining and leaving -------------------------------------------------------------------------

    async def open(self, on_event: Callable[[Announcement | Exited], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._on_event = on_event
        context = Context()
        try:
            if self._tuned:
                chosen = dds_profiles.of_this_process()
                with dds_profiles.in_force(chosen) as check:
                    self._join(context)
                self.tuning = check.tuning
            else:
                self._join(context)
        except Exception as error:  # rclpy's own kinds are not public
            context.try_shutdown()
            raise BackendError(f"ROS 2 cannot be joined: {error}") from error
        self._context = context
        self._opened = time.monotonic()
        self._spinner = ExecutorThread("midstride-manager", context, self._tell)
        self._spinner.executor.add_node(self._node)
        group = ReentrantCallbackGroup()
        self._caller = Caller(self._node, self._spinner.executor, group)
        events.subscription(self._node, self._on_backend_event, group)
        self._spinner.start()
        self._own_clock.follow(self._node.get_clock())
        for words in self.tuning.untuned:
            self._node.get_logger().warning(words)

    def _join(self, context: Any) -> None:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(
            f"_midstride_manager_{os.getpid()}",
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[
                Parameter("start_type_description_service", value=False),
                Parameter("use_sim_time", value=self._use_sim_time),
            ],
        )

    async def close(self) -> None:
        self._children.close()
        if self._context is None:
            return
        context, self._context = self._context, None
        if not await asyncio.to_thread(self._spinner.stop, _JOIN):
            raise BackendError("the manager's own ROS 2 thread does not end")
        self._node.destroy_node()
        context.try_shutdown()

    # -- components ----------------------------------------------------------------------------------

    async def start(self, launch: Launch) -> Handle:
        full_name = names.full(launch.instance, launch.namespace)
        command = common.command(launch.arguments, launch.directory, os.environ, lambda: sys.executable)
        await self._must_be_free(launch.instance, full_name)
        environment = launching.environment(launch, command[0], self.tuning, os.environ)
        log = self._log_of(launch)
        process = spawn(command, launch.directory, environment, log)
        self._children.take(launch.instance, process)
        return Handle(launch.instance, process.pid, process.started, str(log))

    async def adopt(self, handle: Handle) -> bool:
        instance, full_name = handle.instance, names.full(handle.instance)
        if instance in self._children:
            return True
        if handle.pid is None or handle.started is None:
            return await self._caller.ready(full_name, _FIND)
        log = None if handle.log is None else Path(handle.log)
        process = find(handle.pid, handle.started, ENV_INSTANCE, instance, log)
        if process is None:
            return False
        self._children.take(instance, process)
        if not await self._caller.ready(full_name, _FIND) and process.running:
            raise Unreachable(f"{instance} runs (process {handle.pid}), but its control service is not to be found")
        return process.running

    async def call(self, instance: str, command: Command, timeout: float) -> Reply:
        calling = self._caller.call(names.full(instance), command, timeout)
        return await self._children.while_running(instance, command.op, calling)

    async def end(self, instance: str, grace: float) -> None:
        if await self._children.end(instance, grace):
            self._forget(instance)

    def _exited(self, instance: str, status: int | None, process: Process) -> None:
        self._forget(instance)
        self._on_event(Exited(instance, status, process.last_words()))

    def _forget(self, instance: str) -> None:
        self._ended[names.full(instance)] = time.monotonic()
        self._caller.forget(names.full(instance))

    def _log_of(self, launch: Launch) -> Path:
        folder = self._logs or _log_folder() / "midstride" / launch.token[:12]
        return folder / f"{names.full(launch.instance, launch.namespace).strip('/').replace('/', '.')}.log"

    # -- the graph -----------------------------------------------------------------------------------

    async def endpoints(self) -> Endpoints:
        node = self._joined()
        publishers: list[tuple[str, str]] = []
        subscribers: list[tuple[str, str]] = []
        for topic, _ in node.get_topic_names_and_types():
            if topic in (events.TOPIC, "/rosout"):
                continue
            publishers += _of(node.get_publishers_info_by_topic(topic), topic)
            subscribers += _of(node.get_subscriptions_info_by_topic(topic), topic)
        visible = frozenset(name for name in self._names() if not names.is_hidden(name) and self._lives(name))
        return Endpoints(visible, tuple(sorted(publishers)), tuple(sorted(subscribers)))

    def _names(self) -> list[str]:
        return [names.full(name, inside) for name, inside in self._joined().get_node_names_and_namespaces()]

    def _lives(self, full_name: str) -> bool:
        """Whether a node in the graph has any endpoint there, as every one has.

        The graph may keep the name of a node that has gone, for good, when the last word of its
        process overtook the news of its end; its endpoints do go.
        """
        node = self._joined()
        name, inside = names.split(full_name)
        with suppress(NodeNameNonExistentError):
            if node.get_publisher_names_and_types_by_node(name, inside):
                return True
            if node.get_subscriber_names_and_types_by_node(name, inside):
                return True
        # Asked for by name, the graph answers for the first of that name, which may be the one that has gone.
        infos = node.get_publishers_info_by_topic(events.TOPIC)
        return any(names.full(info.node_name, info.node_namespace) == full_name for info in infos)

    async def _must_be_free(self, instance: str, full_name: str) -> None:
        """Raises StartFailed where a node of that name runs: two would both answer.

        What has just ended may linger in the graph, and is waited for.
        """
        await asyncio.sleep(max(0.0, self._opened + _LISTEN - time.monotonic()))
        lingers = self._ended.get(full_name)
        deadline = time.monotonic() + (0.0 if lingers is None else _LINGER)
        while full_name in self._names() and self._lives(full_name):
            if time.monotonic() >= deadline:
                raise StartFailed(f"{instance}: a node {full_name} is running already; end it, or use another name")
            await asyncio.sleep(_POLL)

    # -- what is heard -------------------------------------------------------------------------------

    def _on_backend_event(self, event: Any) -> None:
        """In the manager's ROS thread: an announcement goes to the loop, anything else is not for us."""
        for parameter in event.changed_parameters:
            if parameter.name == names.ANNOUNCEMENT:
                try:
                    announcement = Announcement.from_json(parameter.value.string_value)
                except (ValueError, KeyError, TypeError):
                    self._tell(f"{event.node} announced something that is no announcement")
                    continue
                if not self._loop.is_closed():
                    self._loop.call_soon_threadsafe(self._on_event, announcement)

    def _tell(self, failure: str) -> None:
        self._node.get_logger().error(failure)

    def _joined(self) -> Any:
        if self._context is None:
            raise Unreachable("the back end is not open")
        return self._node


class Ros2Clock(SystemClock):
    """The manager's clock: steady as ever, ROS time as its node has it (``use_sim_time``)."""

    def __init__(self) -> None:
        self._ros: Any = None

    def follow(self, ros_clock: Any) -> None:
        self._ros = ros_clock

    def ros_now(self) -> int:
        return super().ros_now() if self._ros is None else int(self._ros.now().nanoseconds)


def _of(infos: list[Any], topic: str) -> list[tuple[str, str]]:
    full = (names.full(info.node_name, info.node_namespace) for info in infos)
    return [(name, topic) for name in full if not names.is_hidden(name)]


def _log_folder() -> Path:
    """Where ROS 2 puts logs."""
    if folder := os.environ.get("ROS_LOG_DIR"):
        return Path(folder)
    home = os.environ.get("ROS_HOME") or os.path.expanduser("~/.ros")
    return Path(home) / "log" if os.path.isabs(home) else Path(tempfile.gettempdir()) / "ros-log"
