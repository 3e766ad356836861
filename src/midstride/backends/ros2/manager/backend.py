"""The manager's side on ROS 2: see :class:`midstride.runtime.backend_protocol.Backend`.

One hidden node in its own context, which looks at the graph and needs no thread. Components are processes
(:mod:`midstride.runtime.process.child_process`), so an exit is known at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sys
import time
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import rclpy
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from midstride.ament_index import component_library, executable
from midstride.backends import processes
from midstride.backends.common import on_new_thread
from midstride.backends.processes import ProcessBackend
from midstride.backends.ros2 import dds_profiles, distributions, names, zenoh_router
from midstride.backends.ros2.component.early_join import hidden_node
from midstride.backends.ros2.manager import component_containers, launching, process_nodes
from midstride.backends.ros2.manager.addressed_services import AddressedServices
from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.container_backend import ContainerBackend
from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.ros2.manager.graph import Graph
from midstride.backends.ros2.manager.node_owner import node_owner
from midstride.backends.ros2.manager.node_services import RosNodeServices
from midstride.backends.ros2.manager.own_names import StartName, named
from midstride.backends.ros2.manager.shared_processes import SharedProcesses
from midstride.backends.ros2.manager.start_arguments import StartArguments
from midstride.backends.ros2.manager.topic_listener import RosListener
from midstride.errors import BackendError, StartFailed, Unreachable
from midstride.foreign.graph_check import GraphEndpoint, Served
from midstride.foreign.page import GATES_FOLDER, Page
from midstride.foreign.preloading import StartedPrograms
from midstride.foreign.relayed_program import differing
from midstride.model.component import KILL_AT_ONCE, ROS_PARAMETERS, ComponentSpec
from midstride.model.contract import Predicate
from midstride.model.instance_names import PRIVATE_NAMES, full_name
from midstride.runtime.backend_protocol import (
    Backend,
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    Launch,
    OtherNodes,
)
from midstride.runtime.process.child_process import Process
from midstride.runtime.process.reaper import Reaper
from midstride.runtime.records.status_forms import Middleware
from midstride.runtime.timeouts import within
from midstride.wire.environment import ENV_SHARED_NAME, ENV_START
from midstride.wire.state import ComponentState

# A manager that has just joined knows no other node yet: that long it listens before it says that a name is free (s).
_LISTEN: Final = 0.3
# How long leaving ROS 2 may take (s).
_LEAVE: Final = 5.0
_RELAY: Final = "midstride.backends.ros2.component.relay_program"

log = logging.getLogger(__name__)


class Ros2Backend(ContainerBackend, Backend):
    """``middleware_settings``: whether processes get Midstride's transports and discovery (:mod:`..dds_profiles`)."""

    name = "ros2"
    shares_processes = True

    def __init__(
        self,
        control: Path,
        *,
        logs: Path | None = None,
        guardian: Reaper | None = None,
        middleware_settings: bool = True,
    ) -> None:
        super().__init__(control, logs, guardian)
        self._set_middleware = middleware_settings
        self._problem = ""
        self.settings = dds_profiles.DdsSettings("")
        self.warnings: list[str] = []
        self._opened = 0.0
        self._context: Any = None
        self._probes = 0
        self._probe_stuck = False
        self._arguments = StartArguments(control / GATES_FOLDER)
        self._shared = SharedProcesses()
        self._foreign_nodes = ForeignNodes(
            control / GATES_FOLDER,
            self.transport,
            self._services_of,
            self._graph_of,
            self._served_by,
            self._nodes_in,
            self._addressed,
            self._load,
            self._not_loaded,
        )

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        self._on_exit = on_exit
        context = Context()
        try:
            self.settings = dds_profiles.of_this_process(enabled=self._set_middleware)
            self._problem = zenoh_router.problem(self.settings.middleware, os.environ)
            with dds_profiles.applied_profile(self.settings) as self.warnings:
                rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
                self._node = hidden_node(f"_midstride_manager_{os.getpid()}", context=context)
        except Exception as error:  # rclpy's own kinds are not public
            context.try_shutdown()
            raise BackendError(f"ROS 2 cannot be joined: {error}") from error
        self._context = context
        self._opened = time.monotonic()
        self._graph = Graph(self._node, marked=self._foreign_nodes.marked)
        self._foreign_nodes.tells_processes = self._graph.rmw.participant is not None
        for words in self.warnings:
            self._node.get_logger().warning(words)

    async def close(self) -> None:
        await self._stop_watching()
        self._shared.close()
        await self._foreign_nodes.close()
        if self._context is not None:
            context, self._context = self._context, None
            await self._leave(context)

    async def _leave(self, context: Any) -> None:
        """Leave ROS 2 in a separate thread: a middleware that has deadlocked never returns from it."""

        def leave() -> None:
            self._node.destroy_node()
            context.try_shutdown()

        try:
            async with within(_LEAVE):
                await on_new_thread(leave)
        except asyncio.TimeoutError:
            log.error("ROS 2 has not let the manager's node go within %g s; it is left behind", _LEAVE)

    def _program(self, launch: Launch, settings: dds_profiles.DdsSettings) -> tuple[tuple[str, ...], StartedPrograms]:
        """The command with its program found, and what it starts, with its environment. Raises StartFailed."""
        program, *rest = launch.arguments
        libraries = []
        if launch.load is not None and launch.foreign is not None:
            libraries = [component_library(launch.foreign.package or "", launch.load.plugin, os.environ)]
        if launch.package is None:
            command = processes.command(launch.arguments, launch.directory, os.environ, self._python)
        else:
            command = (executable(launch.package, program, os.environ), *rest)
        base = processes.surroundings(launch, os.environ)
        environment = launching.environment(launch, self._control, command[0], settings, base)
        whole = processes.prefixed(launch, command, os.environ)
        return whole, StartedPrograms.of(whole, len(launch.prefix), environment, libraries)

    def describe(self, launch: Launch) -> DescribedProcess:
        command, programs = self._program(launch, dds_profiles.of_this_process(enabled=self._set_middleware))
        component, environment = launch.foreign, dict(programs.environment)
        files: dict[str, str] = {}
        request: LoadRequest | None = None
        if component is not None and (not component.once or _is_ros_node(launch)):
            name = _name_once(launch)
            if not component.once:
                name = self._foreign_nodes.start_name(launch, component, lambda _: False)
            arguments, environment, files = self._arguments.describe(launch, component, name, programs)
            command = (*command, *arguments)
            request = self._arguments.load_request(launch, component, name)
        load = () if request is None else request.command()
        return DescribedProcess(command, processes.differences(environment, os.environ), files, load)

    async def start(self, launch: Launch) -> Handle:
        own_name = full_name(launch.instance, launch.namespace)
        node = full_name(launch.node or launch.instance, launch.namespace)
        command, programs = self._program(launch, self.settings)
        environment = dict(programs.environment)
        graph = self._joined()
        if launch.load is not None:
            component_containers.require_interfaces()
            self._shared.require_not_loading(launch)
        await asyncio.sleep(max(0.0, self._opened + _LISTEN - time.monotonic()))
        start_name = StartName(own_name)
        if launch.foreign is None:
            is_taken = graph.has_instance(own_name)
        else:
            if not launch.foreign.once:
                start_name = self._foreign_nodes.start_name(
                    launch,
                    launch.foreign,
                    lambda name: graph.has(name) or bool(graph.of_name(name)),
                    lambda name: node_owner(graph, name, self._control),
                )
            is_taken = start_name.passed and not start_name.shared and graph.has(start_name.full)
            if launch.foreign.gate != "relay" and start_name.full:
                node = start_name.full
        taken_by = None
        if launch.instance in self._processes or await processes.listens(self.transport, launch.instance):
            taken_by = f"it is {launch.instance} of this system"
        elif is_taken or await self._foreign(node, names.system_tag(launch.token)):
            taken_by = node_owner(graph, node, self._control)
        if taken_by is not None:
            words = f"a node {node} is running already: {taken_by}; end it, or use another name"
            raise StartFailed(f"{launch.instance}: {words}")
        graph.starts(own_name)
        if launch.load is not None and not launch.process:
            graph.starts(component_containers.container_name(launch))
        if launch.foreign is None:
            if node in self._foreign_nodes.names or graph.shows_others(node):  # of the system, or known to have ended
                environment[ENV_SHARED_NAME] = "1"
            return await self._spawn(launch, own_name, command, environment)
        if launch.foreign.once:
            if _is_ros_node(launch):
                command = (*command, *self._arguments.of(launch, launch.foreign, _name_once(launch)))
            return await self._spawn(launch, own_name, command, environment)
        if launch.process:
            return await self._start_shared(launch, launch.foreign, start_name, command, programs)
        if launch.foreign.gate == "relay":
            if start_name.full:
                graph.starts(start_name.full)
            return await self._start_relay(launch, launch.foreign, start_name, command, environment)
        environment, record = await self._foreign_nodes.prepare(
            launch, launch.foreign, start_name.full or own_name, programs
        )
        record = msgspec.structs.replace(record, unnamed=not start_name.passed)

        async def end() -> None:
            await ProcessBackend.end(self, launch.instance, KILL_AT_ONCE)
            self._foreign_nodes.discard(record)

        async with self._or_ended(launch, end):
            if not start_name.shared:
                graph.starts(start_name.full or own_name)
            command = (*command, *self._arguments.of(launch, launch.foreign, start_name))
            handle = await self._spawn(launch, own_name, command, environment)
            request = self._arguments.load_request(launch, launch.foreign, start_name)
            await self._foreign_nodes.started(record, handle, request)
        return handle

    async def _start_relay(
        self,
        launch: Launch,
        component: ComponentSpec,
        name: StartName,
        command: Sequence[str],
        program: Mapping[str, str],
    ) -> Handle:
        """``program``: the environment of the program, whose node is started with ``name``."""
        values = {**launch.parameters, **launch.set_parameters}
        simulated = {name: value for name, value in values.items() if name in ROS_PARAMETERS}
        own = replace(launch, parameters=simulated, set_parameters={})  # the others are the program's
        environment = launching.environment(own, self._control, sys.executable, self.settings, os.environ)
        environment[ENV_START] = program[ENV_START]  # what either of them starts belongs to the instance
        different = differing(program, environment)
        order = self._foreign_nodes.prepare_relay(launch, component, name, command, different)
        node = full_name(launch.instance, launch.namespace)
        try:
            return await self._spawn(own, node, (sys.executable, "-m", _RELAY, str(order)), environment)
        except BaseException:
            self._foreign_nodes.gone(launch.instance)
            raise

    async def adopt(self, handle: Handle) -> bool:
        runs = await self._adopt_shared(handle) if handle.instance not in self._processes else True
        if runs is None:
            runs = await super().adopt(handle)
        if runs:
            await self._foreign_nodes.adopt(handle.instance)
        elif not self._shared.is_unanswered(handle.instance):
            self._foreign_nodes.gone(handle.instance)
        return runs

    def executable(self, package: str, name: str, *, composable: bool = False) -> str | None:
        find = component_library if composable else executable
        try:
            return find(package, name, os.environ)
        except StartFailed:
            return None

    def _services_of(self, node: str) -> RosNodeServices:
        return RosNodeServices(self._node, node)

    def _addressed(self, node: str, page: Page, index: int, alone: bool) -> AddressedServices:
        return AddressedServices(self._node, node, page, index, alone=alone)

    def _graph_of(self, node: str, mark: bytes | None) -> list[GraphEndpoint]:
        return [] if self._context is None else self._graph.of_process(node, mark)

    def _served_by(self, node: str, services: frozenset[str] | None, mark: bytes | None) -> Served:
        return Served() if self._context is None else self._graph.served_by(node, services, mark)

    def _nodes_in(self, enclave: str) -> list[str]:
        return [] if self._context is None else self._graph.of_enclave(enclave)

    def _python(self) -> str:
        return sys.executable

    def _environment_of_spares(self, token: str) -> dict[str, str]:
        launch = Launch("", "", (), token, Path("/"))
        return launching.environment(launch, self._control, sys.executable, self.settings, os.environ)

    async def _foreign(self, node: str, system: str) -> bool:
        """Return whether a node of that name is in the graph that is no instance of the system."""
        for found in self._joined().of_name(node):
            if found is None and self._foreign_nodes.runs_unmarked(node):
                continue  # of the system, and without Midstride's API
            if found is None or found.node != node or found.system not in ("", system):
                return True
            if not found.system and not await processes.listens(self.transport, found.instance.strip("/")):
                return True
        return False

    def _exited(self, instance: str, status: int | None, process: Process) -> None:
        self._gone(instance)
        self._on_exit(Exited(instance, status, process.last_words()))

    async def _died(self, instance: str) -> None:
        self._gone(instance)

    def _gone(self, instance: str) -> None:
        node, mark = self._foreign_nodes.node_of(instance) or full_name(instance), self._foreign_nodes.mark_of(instance)
        self._foreign_nodes.gone(instance)
        if self._context is None or (mark is not None and self._graph.ended(mark)):
            return
        for name in {node, full_name(instance)}:
            if not self._foreign_nodes.runs(name):  # that of its successor
                self._graph.died(name)

    def disconnected(self, instance: str) -> None:
        if self._context is not None:
            self._graph.ignore(full_name(instance))

    def reported(self, state: ComponentState) -> None:
        self._foreign_nodes.note(state)

    def reach(self) -> dict[str, str]:
        domain = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
        with contextlib.suppress(ValueError):
            domain = str(int(domain))
        return {"ROS_DOMAIN_ID": domain, "RMW_IMPLEMENTATION": rclpy.get_rmw_implementation_identifier()}

    def unwritten(self) -> str | None:
        return self._foreign_nodes.unwritten()

    def middleware(self) -> Middleware:
        found = self.settings.described(os.environ, self.warnings)
        library = self._foreign_nodes.library_origin()
        return msgspec.structs.replace(
            found,
            domain=self.reach()["ROS_DOMAIN_ID"],
            distribution=distributions.of_this_process(),
            problem=self._problem,
            notes=[*found.notes, *([] if library is None else [library])],
        )

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        return self._joined().endpoints(topics)

    def other_nodes(self, instances: Collection[str]) -> dict[str, OtherNodes]:
        asked = self._foreign_nodes.processes(name for name in sorted(instances) if name in self._processes)
        if self._context is None or not asked:
            return {}
        return process_nodes.other_nodes(self._graph, asked, self.families)

    @asynccontextmanager
    async def probe(self) -> AsyncIterator[str | None]:
        """In separate threads: a middleware that has deadlocked returns from neither."""
        if self._probe_stuck:
            yield None
            return
        self._probes += 1
        topic = f"{PRIVATE_NAMES}probe_{os.getpid()}_{self._probes}"
        node, qos = self._node, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        publisher = await self._in_time(lambda: node.create_publisher(ParameterEvent, topic, qos))
        try:
            yield None if publisher is None else topic
        finally:
            if publisher is not None and self._context is not None:
                await self._in_time(lambda: node.destroy_publisher(publisher))

    async def _in_time(self, work: Callable[[], Any]) -> Any:
        """Call ``work``, and return its result; None, and no more probes, where the middleware does not return."""
        try:
            async with within(_LEAVE):
                return await on_new_thread(work)
        except asyncio.TimeoutError:
            self._probe_stuck = True
            log.error("the middleware of the manager does not return: it may have stopped discovering")
            return None

    def listen(self, topic: str, assumption: Predicate) -> RosListener:
        return RosListener(self._node, self._joined(), topic, assumption)

    async def publisher_ids(self, topic: str, instance: str) -> frozenset[str] | None:
        if (name := self._foreign_nodes.shown_as(instance)) is None:
            return None
        return self._joined().publisher_ids(topic, name)

    async def lingering_readers(self, topic: str) -> int:
        return self._joined().lingering_readers(topic)

    def _joined(self) -> Graph:
        if self._context is None:
            raise Unreachable("the back end is not open")
        return self._graph


def _is_ros_node(launch: Launch) -> bool:
    """Return whether a program that ends gets arguments for ROS, as a node in a launch file."""
    return launch.package is not None or bool(launch.parameters or launch.sections)


def _name_once(launch: Launch) -> StartName:
    """The name that a program that ends is started with."""
    assert launch.foreign is not None
    if launch.foreign.unnamed:
        return StartName("", passed=False)
    return named(full_name(launch.instance, launch.namespace), launch.foreign)
