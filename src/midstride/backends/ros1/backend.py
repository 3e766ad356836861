"""The manager's side on ROS 1: see :class:`midstride.runtime.backend_protocol.Backend`.

The manager is no node of ROS 1. It calls the master's XML-RPC API (:mod:`.rpc`) on its own event loop: it imports no
ROS library, every call has a deadline, and none blocks a thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Final

import msgspec

from midstride.backends import naming, processes
from midstride.backends.common import in_background
from midstride.backends.ros1 import launching, master_process, names, rpc
from midstride.backends.ros1.master import Master
from midstride.codec.component_form import NamedComponentForm
from midstride.errors import BackendError, StartFailed, Unreachable
from midstride.foreign.page import GATES_FOLDER
from midstride.foreign.relayed_program import RelayOrder, order_file, private_topics
from midstride.model.component import ComponentSpec
from midstride.model.instance_names import full_name, split_name
from midstride.runtime.backend_protocol import (
    RELAY_SUFFIX,
    Backend,
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    Launch,
)
from midstride.runtime.process.child_process import Process
from midstride.runtime.process.reaper import Reaper
from midstride.runtime.records.status_forms import Middleware
from midstride.runtime.timeouts import within

# How long taking back the registrations of a dead node may delay the report of its end (s).
_TIDY: Final = 1.0
_RELAY: Final = f"{__package__}.relay_program"
# The file of the nodes that are not called as their instances are.
_NODE_NAMES: Final = "node-names"


class Ros1Backend(processes.ProcessBackend, Backend):
    """Starts a master if none answers; ``started_master``: whether it has."""

    name = "ros1"

    def __init__(self, control: Path, *, logs: Path | None = None, guardian: Reaper | None = None) -> None:
        super().__init__(control, logs, guardian)
        self.started_master = False
        self._mark: socket.socket | None = None  # while it is open
        self._tidying: set[asyncio.Task[None]] = set()
        self._dead: set[str] = set()  # nodes whose process has ended, and that the master may still list

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        uri = launching.master_uri(os.environ)
        try:
            rpc.address(uri)
        except ValueError as error:
            raise BackendError(f"{launching.MASTER_URI} does not name a ROS master: {error}") from None
        environment = launching.environment(os.environ, uri)
        self._on_exit = on_exit
        self._master = Master(uri, names.MANAGER)
        mark = master_process.hold(uri)
        try:
            folder = self._log_folder()
            self.started_master = await master_process.ensure(self._master, environment, folder, self._guardian)
        except BaseException:
            mark.close()
            raise
        self._mark = mark

    async def close(self) -> None:
        """Leave; the components keep running, and so does the master, unless there are none and it was started here."""
        any_left = bool(self._processes)
        await self._stop_watching()
        if self._mark is None:
            return
        await asyncio.gather(*self._tidying, return_exceptions=True)
        self._mark.close()
        self._mark = None
        if not any_left:
            with contextlib.suppress(BackendError):  # a master that does not answer is left alone
                await master_process.release(self._master, self._guardian)

    def _program(self, launch: Launch) -> tuple[str, ...]:
        """The command with its program found. Raises StartFailed."""
        command = processes.command(launch.arguments, launch.directory, os.environ, self._python)
        return processes.prefixed(launch, command, os.environ)

    def describe(self, launch: Launch) -> DescribedProcess:
        """Parameters of a program without Midstride's API are on the master, and in no file."""
        command, component = self._program(launch), launch.foreign
        node = full_name(launch.instance, launch.namespace)
        if component is not None and not component.once:
            topics = naming.topics_of(component, node, launch.topics) | private_topics(component, launch.instance)
            arguments = [f"{component.topic_of(port)}:={topic}" for port, topic in topics.items()]
            command = (*command, *arguments, f"__name:={split_name(node)[0]}")
        environment = {
            **launching.environment(processes.surroundings(launch, os.environ), launching.master_uri(os.environ)),
            **processes.identity(launch, self.name, self._control),
            launching.NAMESPACE: split_name(launch.instance, launch.namespace)[1],
        }
        return DescribedProcess(command, processes.differences(environment, os.environ))

    async def start(self, launch: Launch) -> Handle:
        master = self._opened()
        own, command = full_name(launch.instance, launch.namespace), self._program(launch)
        node = await self._free_name(launch)
        self._note_node(launch.instance, node)
        if launch.foreign is not None:
            if not launch.foreign.once:
                command = self._relay(launch, launch.foreign, node, command)
            elif launch.parameters:  # a node, which has to know its name
                command = (*command, f"__name:={split_name(node)[0]}")
            # They are the program's. On its command line, roscpp would take the quotes of a string for a part of it.
            for name, value in _values(launch).items():
                await master.set_parameter(_parameter(node, name), value)
            launch = replace(launch, parameters={}, set_parameters={})
        environment = self._environment(launch)
        if node != own and launch.foreign is None:
            environment[launching.ENV_NODE] = split_name(node)[0]
        handle = await self._spawn(launch, own, command, environment)
        self._dead.discard(node)
        return handle

    async def _free_name(self, launch: Launch) -> str:
        """The full name of the node of an instance, which no node has yet: the master would end the first of two.

        A replacement gets another number than its instance has where a node outside the system has that name. Raises
        StartFailed.
        """
        master, node = self._opened(), full_name(launch.instance, launch.namespace)
        if not await master.is_running(node):
            return node
        if launch.instance == (launch.role or launch.instance):
            where = await master.address_of(node)
            raise StartFailed(
                f"{launch.instance}: a node {node} is running already, at {where}, and a second one of its name would "
                "end it; end it yourself, or use another name"
            )
        for number in count(2):
            other = full_name(f"{launch.role}_{number}", launch.namespace)
            if not await master.is_running(other):
                return other
        raise AssertionError("there is always a further number")

    def _note_node(self, instance: str, node: str) -> None:
        """Keep the full name of the node of an instance until another one of that name is started.

        The next manager needs it, too: by the name of the instance it would take back what a node outside the system
        has registered. Raises StartFailed.
        """
        path, known = self._control / GATES_FOLDER / _NODE_NAMES, self._node_names()
        if known.get(instance, full_name(instance)) == node:
            return
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            path.write_bytes(msgspec.json.encode({**known, instance: node}))
        except OSError as error:
            raise StartFailed(f"{path} cannot be written: {error.strerror or error}") from None

    def _node_names(self) -> dict[str, str]:
        try:
            return msgspec.json.decode((self._control / GATES_FOLDER / _NODE_NAMES).read_bytes(), type=dict[str, str])
        except (OSError, msgspec.DecodeError):
            return {}

    def _node_of(self, instance: str) -> str:
        """The full name of the node of an instance."""
        return self._node_names().get(instance) or full_name(instance)

    def _relay(self, launch: Launch, component: ComponentSpec, node: str, command: Sequence[str]) -> tuple[str, ...]:
        """The command of the relay of a program, whose node is ``node``."""
        topics = naming.topics_of(component, node, launch.topics) | private_topics(component, launch.instance)
        arguments = [f"{component.topic_of(port)}:={topic}" for port, topic in topics.items()]
        arguments += [f"__name:={split_name(node)[0]}"]
        order = RelayOrder(
            command=[*command, *arguments],
            node=node,
            declaration=NamedComponentForm.of(component),
            topics=topics,
            real={port: topic for port, topic in launch.topics.items() if component.has_output(port)},
            stated=_values(launch),
        )
        order.write(path := self._order_file(launch.instance))
        return self._python(), "-m", _RELAY, str(path)

    def _order_file(self, instance: str) -> Path:
        return order_file(self._control / GATES_FOLDER, instance)

    def _environment(self, launch: Launch) -> dict[str, str]:
        return {
            **launching.environment(processes.surroundings(launch, os.environ), self._opened().uri),
            **processes.identity(launch, self.name, self._control),
            launching.NAMESPACE: split_name(launch.instance, launch.namespace)[1],
        }

    def _python(self) -> str:
        return launching.require_interpreter()

    def _environment_of_spares(self, token: str) -> dict[str, str]:
        return self._environment(Launch("spare", "", (), token, Path("/")))

    async def adopt(self, handle: Handle) -> bool:
        """Raises Unreachable for a component that runs on another master."""
        instance, known = handle.instance, handle.instance in self._processes
        running = await super().adopt(handle)
        if handle.pid is None or known:
            return running
        if instance not in self._processes:
            await self._died(instance)
            return False
        master, here = launching.master_of(handle.pid), self._opened()
        if master != here.uri and await here.address_of(self._node_of(instance)) is None:
            raise Unreachable(
                f"{instance} runs (process {handle.pid}) with {launching.MASTER_URI}={master}, and this manager has "
                f"{here.uri}: set {launching.MASTER_URI}={master}, or end the component"
            )
        return running

    def _exited(self, instance: str, status: int | None, process: Process) -> None:
        """Clean up, then report: after the report another component may be started on the same port."""

        async def tidy_and_report() -> None:
            try:
                await self._died(instance)
            finally:  # whatever the master has answered
                self._on_exit(Exited(instance, status, process.last_words()))

        in_background(tidy_and_report(), self._tidying)

    def disconnected(self, instance: str) -> None:
        in_background(self._died(instance), self._tidying)

    async def _died(self, instance: str) -> None:
        """Take back what a component that has ended may have left with the master, in bounded time."""
        ended, given = [self._node_of(instance)], list[str]()
        if (path := self._order_file(instance)).exists():  # that was the node of its program
            ended.append(f"{full_name(instance)}{RELAY_SUFFIX}")
            with contextlib.suppress(BackendError):
                order = RelayOrder.read(path)
                given = [_parameter(order.node, name) for name in order.stated]
            path.unlink()
        self._dead.update(ended)
        with contextlib.suppress(BackendError, asyncio.TimeoutError):
            async with within(_TIDY):
                for node in ended:
                    await self._opened().unregister(node)
                    self._dead.discard(node)
                for name in given:  # the next program of its name would read them
                    await self._opened().delete_parameter(name)

    def middleware(self) -> Middleware:
        variables = (launching.MASTER_URI, "ROS_HOSTNAME", "ROS_IP")
        kept = {name: value for name in variables if (value := os.environ.get(name))}
        master = launching.master_uri(os.environ)
        given = launching.environment(os.environ, master)
        added = {name: given[name] for name in variables if name in given and name not in kept}
        distribution = os.environ.get("ROS_DISTRO", "")  # set where one is sourced, and nowhere else
        return Middleware(name="TCPROS", master=master, distribution=distribution, set=added, kept=kept)

    def reach(self) -> dict[str, str]:
        return {"ROS_MASTER_URI": launching.master_uri(os.environ)}

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        state = await self._opened().state()
        publishers, subscribers = (self._alive(each, topics) for each in (state.publishers, state.subscribers))
        return Endpoints(state.nodes() - self._dead, publishers, subscribers)

    def _alive(
        self, nodes_of: Mapping[str, tuple[str, ...]], topics: Collection[str] | None
    ) -> tuple[tuple[str, str], ...]:
        known = nodes_of.keys() - names.INTERNAL - {naming.DIAGNOSTICS}
        asked = known if topics is None else known & {*topics}
        return tuple(sorted((node, topic) for topic in asked for node in nodes_of[topic] if node not in self._dead))

    @contextlib.asynccontextmanager
    async def probe(self) -> AsyncIterator[str | None]:
        yield None  # the master does it

    async def lingering_readers(self, topic: str) -> int:
        """Almost always 0: a dead node's registrations are withdrawn before its end is reported."""
        if not self._dead:
            return 0
        return sum(node in self._dead for node in (await self._opened().state()).subscribers.get(topic, ()))

    def _opened(self) -> Master:
        if self._mark is None:
            raise Unreachable("the back end is not open")
        return self._master


def _values(launch: Launch) -> dict[str, object]:
    return {**launch.parameters, **launch.set_parameters}


def _parameter(node: str, name: str) -> str:
    """The full name of a parameter of a node: below another one where the specification has a dot."""
    return f"{node}/{name.replace('.', '/')}"
