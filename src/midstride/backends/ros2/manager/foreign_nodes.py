"""Nodes that do not use Midstride's API: how they are started behind their gates, and the agents in their place."""

from __future__ import annotations

import asyncio
import logging
import os
import time
import uuid
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

from msgspec.structs import replace

from midstride.backends.common import in_background
from midstride.backends.naming import topics_of
from midstride.backends.ros2.manager.component_containers import LoadRequest, container_name
from midstride.backends.ros2.manager.own_names import OwnNames, StartName
from midstride.backends.ros2.manager.parameter_file import parameter_file
from midstride.backends.ros2.manager.process_nodes import AskedProcess
from midstride.backends.ros2.manager.relays import Relays
from midstride.backends.ros2.manager.shared_processes import SharedProcess
from midstride.backends.ros2.manager.start_arguments import (
    ENV_NODE,
    ENV_PAGE,
    loads_library,
)
from midstride.backends.ros2.names import InstanceNode, enclave_of, system_tag
from midstride.codec.component_form import NamedComponentForm
from midstride.codec.parameter import json_values
from midstride.errors import BackendError, CommandRefused, MidstrideError, NodeError, StartFailed
from midstride.foreign import build
from midstride.foreign.foreign_state import StatePeers
from midstride.foreign.gated_agent import ForeignAgent
from midstride.foreign.gates import Gates
from midstride.foreign.graph_check import GraphEndpoint, Served, endpoints_seconds
from midstride.foreign.lifecycle_managers import LifecycleManagers
from midstride.foreign.lifecycle_outputs import LifecyclePeers
from midstride.foreign.node import of_services, of_topics
from midstride.foreign.own_node_search import NODE_LOOK, OwnNodeSearch
from midstride.foreign.page import PAGE, Page, kept_results
from midstride.foreign.preloading import PRELOAD, StartedPrograms
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import ReportedStates
from midstride.foreign.services import NodeServices
from midstride.foreign.sharing_components import forget_component, share_requests
from midstride.model.component import ComponentSpec
from midstride.model.instance_names import full_name, split_name
from midstride.runtime.backend_protocol import Handle, Launch
from midstride.wire.state import ComponentState
from midstride.wire.transport import Transport

# What the graph shows of a node, by its full name and, where its process has one, its mark.
GraphOf: TypeAlias = Callable[[str, bytes | None], Sequence[GraphEndpoint]]
# What a node serves, by its full name and, where they are known, the full names of its services and its mark.
ServedBy: TypeAlias = Callable[[str, frozenset[str] | None, bytes | None], Served]
# What the node of a page with this full name and index can be asked, and whether no other had its name at its start.
Addressed: TypeAlias = Callable[[str, Page, int, bool], NodeServices]
# Has the node of a record loaded within a time (s).
Load: TypeAlias = Callable[[ForeignRecord, LoadRequest, float], Awaitable[None]]

# How long the calls of a node get at least that have begun when it is to be unloaded (s), and how often it is asked
# whether one still runs.
_LAST_CALLS: Final = 0.1
_LOOK: Final = 0.02

log = logging.getLogger(__name__)


class ForeignNodes:
    """The foreign nodes of one system, with page and records in ``folder`` and agents that listen on ``transport``.

    ``services(node)``: what a node, by its full name, can be asked; ``graph(node)``: what the graph shows of it;
    ``served(node)``: what the node serves; ``nodes_in(enclave)``: the full names of the nodes in it. To both of the
    former, the mark and the services of a node with a gate inside are passed, where they are known.
    ``addressed``: what one of several nodes of a name can be asked. ``load``: carries out a request to a container
    within a time (s), or raises BackendError; ``failed`` is then called with the instance and why.
    """

    def __init__(
        self,
        folder: Path,
        transport: Transport,
        services: Callable[[str], NodeServices | None],
        graph: GraphOf | None = None,
        served: ServedBy | None = None,
        nodes_in: Callable[[str], Sequence[str]] = lambda enclave: (),
        addressed: Addressed | None = None,
        load: Load | None = None,
        failed: Callable[[str, str], Awaitable[None]] | None = None,
    ) -> None:
        self._folder = folder
        self._transport = transport
        self._services = services
        self._graph = graph
        self._served = served
        self._peers = LifecyclePeers()
        self._states = StatePeers()
        self._managers = LifecycleManagers(services)
        self._reported = ReportedStates()
        self._page: Page | None = None
        self._agents: dict[str, ForeignAgent] = {}
        self._names: set[str] = set()  # the full names of their ROS nodes, also of those that have ended
        self._closing: set[asyncio.Task[None]] = set()
        self._own_names = OwnNames(folder)
        self._relays = Relays(folder, self._own_names)
        self._finding: dict[str, asyncio.Task[None]] = {}
        self._nodes_in = nodes_in
        self._addressed = addressed
        self._load = load
        self._failed = failed
        self.tells_processes = False  # whether the graph tells which process an endpoint belongs to

    @property
    def names(self) -> set[str]:
        """The full names of their ROS nodes, also of those that have ended, and of those behind relays."""
        return self._names | self._relays.names

    def start_name(
        self, launch: Launch, component: ComponentSpec, runs: Callable[[str], bool], owner: Callable[[str], str] = str
    ) -> StartName:
        """Return what the node of the instance is called; the arguments are as for :class:`OwnNames`.

        A replacement with the library in its process has the name of a node that has it, too: one of them answers. In
        one process, the names distinguish the two.
        Raises StartFailed.
        """
        old = self._agents.get(launch.predecessor)
        inside = old is not None and bool(launch.process) and old.node.record.process == launch.process
        if component.loads_library and old is not None and not inside and self._can_share(old.node.record):
            shared = self._own_names.shared_name(old.node.record.node, launch, component)
            if shared is not None:
                return shared
        return self._own_names.start_name(launch, component, lambda node: runs(node) or self.runs(node), owner)

    def _can_share(self, record: ForeignRecord) -> bool:
        """Return whether another node may have the name of this one: its library claims requests."""
        return bool(record.node) and self.tells_processes and self._servers(record) is not None

    def marked(self) -> list[tuple[bytes, InstanceNode]]:
        """The instances whose gate is inside, each with the identity of a publisher of its process.

        After them, without an instance, the nodes that their containers have besides: one that is not unloaded, or that
        the container has said to have unloaded and the graph shows still.
        """
        found, containers = [], dict[int, tuple[bytes, str]]()
        records = [agent.node.record for agent in self._agents.values()]
        for record in records:
            if (mark := self._mark(record)) is not None and record.node:
                inside, system = split_name(record.node)[1], system_tag(record.token)
                found.append((mark, InstanceNode(full_name(record.instance, inside), record.node, system)))
                if record.process_index is not None:
                    containers[record.process_index] = mark, system
        known = {record.index for record in records}
        for process, (mark, system) in containers.items():
            if self._page is not None:
                found += [(mark, InstanceNode("", node, system)) for node in self._page.loaded_into(process, known)]
        return found

    def shown_as(self, instance: str) -> str | None:
        """The name that the graph shows endpoints of an instance under; None where it does not tell them from others'.

        That is so of one whose process has its gate inside, and no mark.
        """
        if (agent := self._agents.get(instance)) is None:
            return full_name(instance)
        record = agent.node.record
        return full_name(instance, split_name(record.node)[1]) if record.node and self._mark(record) else None

    def mark_of(self, instance: str) -> bytes | None:
        """The identity of a publisher of the process of an instance; None where it is not known."""
        agent = self._agents.get(instance)
        return None if agent is None else self._mark(agent.node.record)

    def _mark(self, record: ForeignRecord) -> bytes | None:
        return None if record.index is None or self._page is None else self._page.mark(record.index)

    async def prepare_shared(
        self, launch: Launch, component: ComponentSpec, started: StartedPrograms
    ) -> tuple[dict[str, str], int | None]:
        """The environment of the process of a container that several nodes share, and its part in the page.

        ``launch``: of the first of them. None: it has no library, and that one needs none. Raises StartFailed,
        BackendError.
        """
        environment = started.environment
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not loads_library(launch, component, started):
            available = build.is_available(environment)
            if not available or started.why_not(build.library_path(environment)) is not None:
                return dict(environment), None
        page, library = await self._opened(environment)
        index = page.allocate(launch.process)
        return _preloaded(started, page, library, index), index

    def discard_shared(self, name: str, index: int | None) -> None:
        """The process of a container has ended, or could not be started."""
        parameter_file(self._folder, name).unlink(missing_ok=True)
        if index is not None and self._page is not None:
            self._page.free(index)

    def records(self) -> list[ForeignRecord]:
        """All records that can be read, also of an earlier manager."""
        return [*ForeignRecord.all(self._folder)]

    def record_of(self, instance: str) -> ForeignRecord | None:
        """Read what an earlier manager has left of an instance; None where there is nothing. Raises BackendError."""
        return ForeignRecord.read(self._folder, instance)

    async def prepare(
        self,
        launch: Launch,
        component: ComponentSpec,
        node: str,
        started: StartedPrograms,
        shared: SharedProcess | None = None,
    ) -> tuple[dict[str, str], ForeignRecord]:
        """The environment of the process, and its record, still without the process. Raises StartFailed, BackendError.

        ``node`` is the full name of its ROS node; ``started``: what its command starts; ``shared``: the process that
        runs, and is to load it.
        """
        environment = started.environment
        await asyncio.gather(*self._closing)  # the name may be that of one that has just ended
        topics, index, variables = topics_of(component, node, launch.topics), None, dict(environment)
        process_index = None if shared is None else shared.index
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if shared is not None and process_index is None and component.preloads:
            raise StartFailed(f"{launch.instance}: {shared.name} was started without the library of the gate")
        without = shared is not None and process_index is None
        if not without and loads_library(launch, component, started):
            page, library = await self._opened(environment)
            index = page.allocate(launch.instance, process=process_index, name="" if shared is None else node)
            old = self._agents.get(launch.predecessor)
            before = None if old is None else old.node.record.index
            if old is None and launch.standby and launch.predecessor:  # a component with the API, or a relay
                before = share_requests(page, launch.predecessor)
            if component.preloads:
                Gates(page, index, of_topics(component)).prepare(topics, before)
            else:
                Gates(page, index, of_services(component)).prepare_requests(before)
            variables = _preloaded(started, page, library, index)
        record = ForeignRecord(
            instance=launch.instance,
            node=node,
            token=launch.token,
            uuid=uuid.uuid4().hex,
            pid=0,
            started=time.time_ns(),
            declaration=NamedComponentForm.of(component),
            index=index,
            topics=topics,
            modes={functionality.name: functionality.modes[-1].name for functionality in component},
            outputs=[port for port in component.outputs if port in launch.topics],
            stated=json_values(launch.parameters),
            taken_over=json_values(launch.set_parameters),
            predecessor=self._node_name(launch.predecessor, launch.namespace) if launch.predecessor else None,
            was_active=(old := self._agents.get(launch.predecessor)) is not None and old.node.record.was_active,
            role=launch.role,
            replaces=launch.predecessor,
            container=container_name(launch) if launch.load is not None else "",
            process=launch.process,
            process_index=process_index,
        )
        return variables, record

    def prepare_relay(
        self,
        launch: Launch,
        component: ComponentSpec,
        name: StartName,
        command: Sequence[str],
        environment: Mapping[str, str | None],
    ) -> Path:
        """The file of the order of a relay; the arguments are those of :class:`RelayOrder`. Raises BackendError."""
        return self._relays.prepare(launch, component, name, command, environment, self._lifecycle_node(launch))

    def _lifecycle_node(self, launch: Launch) -> str:
        """The full name of the lifecycle node that an instance replaces; empty where there is none."""
        if not launch.predecessor or self._served is None:
            return ""
        node, old = self._node_name(launch.predecessor, launch.namespace), self._agents.get(launch.predecessor)
        record = None if old is None else old.node.record
        found = self._served(node, None, None) if record is None else self._served_now(self._served, record)
        return node if found.has_lifecycle else ""

    def _served_now(self, served: ServedBy, record: ForeignRecord) -> Served:
        """Ask ``served`` for what the node of an instance serves, of those of its name.

        While its library has seen no service of it yet, the graph would list those of another node of that name.
        """
        services = self._servers(record)
        others = [each.node.record for each in self._agents.values() if each.node.record.instance != record.instance]
        if services is None and record.index is not None and record.node in {each.node for each in others}:
            return Served()
        return served(record.node, services, self._mark(record))

    def _servers(self, record: ForeignRecord) -> frozenset[str] | None:
        """The services that the gate inside the process sees; None where there is none, or it sees none.

        Those of a container are not the node's: they end with each of them, and nothing else calls them.
        """
        if record.index is None or self._page is None or not (found := self._page.servers(record.index)):
            return None
        return frozenset(each for each in found if not record.container or not each.startswith(f"{record.container}/"))

    async def _opened(self, environment: Mapping[str, str]) -> tuple[Page, Path]:
        library = await asyncio.to_thread(build.library, environment)
        if self._page is None:
            path = self._folder / PAGE
            if not any(self._folder.glob("*.json")):
                path.unlink(missing_ok=True)  # nothing uses it, and an earlier version may have made it
                for kept in kept_results(path):
                    kept.unlink(missing_ok=True)
            self._page = Page(path, library)
        return self._page, library

    def library_origin(self) -> str | None:
        """The library of the gate that its processes have, in words; None where none has one."""
        return None if self._page is None else f"gate: the library is {build.origin()}"

    def note(self, state: ComponentState) -> None:
        """A component has reported this."""
        self._relays.reported(state.instance)
        # With an agent here, what it says of `/clock` comes from here as well.
        self._reported.note(state, has_agent=state.instance not in self._agents)

    def runs(self, node: str) -> bool:
        """Return whether a process without Midstride's API has the ROS node of this full name."""
        return self._relays.runs(node) or any(a.node.record.node == node for a in self._agents.values())

    def runs_unmarked(self, node: str) -> bool:
        """Return whether a process has this node, and no mark by which the graph tells it from others."""
        records = (agent.node.record for agent in self._agents.values())
        return self._relays.runs(node) or any(each.node == node and not self._mark(each) for each in records)

    def unwritten(self) -> str | None:
        """The reason why the record of one of them could not be written."""
        return next((why for agent in self._agents.values() if (why := agent.node.unwritten) is not None), None)

    def discard(self, record: ForeignRecord) -> None:
        """The process could not be started, or has ended."""
        parameter_file(self._folder, record.instance).unlink(missing_ok=True)
        if record.index is not None and self._page is not None:
            self._page.free(record.index)

    async def started(self, record: ForeignRecord, handle: Handle, request: LoadRequest | None = None) -> None:
        """Have an agent answer for the process, once its node is known. Raises BackendError, NodeError.

        ``request``: what loads the node into it.
        """
        record = replace(record, pid=handle.pid or 0, loaded=request is None)
        record.write(self._folder)
        if request is None or self._load is None:
            await self._answer_once_known(record)
        else:
            self._search(record.instance, self._answer_once_loaded(record, self._load, request))

    async def _answer_once_loaded(self, record: ForeignRecord, load: Load, request: LoadRequest) -> None:
        """Answer for the node once it is loaded; else it is said why it cannot be started."""
        try:
            await load(record, request, endpoints_seconds(record.declaration.declared()))
            record = replace(record, loaded=True)
            record.write(self._folder)
            await self._answer_once_known(record)
        except Exception as error:  # rclpy's too, of a value that no message can have; nothing awaits this task
            if not isinstance(error, MidstrideError):
                log.exception("%s cannot be loaded", record.instance)
            self._finding.pop(record.instance, None)  # this task, which goes on until the process has ended
            if self._failed is not None:
                await self._failed(record.instance, str(error))

    def _search(self, instance: str, work: Coroutine[None, None, None]) -> None:
        """Have ``work`` done as long as the process of the instance runs."""
        task = asyncio.get_running_loop().create_task(work)
        self._finding[instance] = task
        task.add_done_callback(lambda _: self._finding.pop(instance, None))

    async def _answer_once_known(self, record: ForeignRecord) -> None:
        if not record.declaration.declared().unnamed or (record.node and record.welcomed):
            await self._answer(record)
            return
        self._managers.starting[record.instance] = record.role
        self._search(record.instance, self._find(record))

    async def _find(self, record: ForeignRecord) -> None:
        """Wait until the graph shows the node, and answer for it; one without a node is answered for all the same."""
        enclave = enclave_of(system_tag(record.token), record.instance)
        expected = self._own_names.known(record.role) if record.unnamed else record.node
        search = OwnNodeSearch(expected, endpoints_seconds(record.declaration.declared()))
        while not search.look(self._nodes_in(enclave)):
            await asyncio.sleep(NODE_LOOK)
        try:
            if search.node:
                if record.unnamed:
                    self._own_names.note(record.role, search.node)
                record = replace(record, node=search.node)
                record.write(self._folder)
            await self._answer(record)
        except (BackendError, NodeError) as error:
            log.error("%s cannot be answered for: %s", record.instance, error)

    def node_of(self, instance: str) -> str | None:
        """The full name of the node of an instance, once it is known; of a relay, that of its program's."""
        if (agent := self._agents.get(instance)) is not None:
            return agent.node.record.node
        return self._relays.node_of(instance)

    def _node_name(self, instance: str, namespace: str) -> str:
        return self.node_of(instance) or full_name(instance, namespace)

    def processes(self, instances: Iterable[str]) -> list[AskedProcess]:
        """The way in which the nodes of the process of each instance are found."""
        return [self._process(instance) for instance in instances]

    def _process(self, instance: str) -> AskedProcess:
        if (node := self._relays.node_of(instance)) is not None:
            return AskedProcess(instance, node, programs=2)
        if (agent := self._agents.get(instance)) is None:
            return AskedProcess(instance)
        record = agent.node.record
        listed = None if record.index is None or self._page is None else self._page.ros_nodes(record.index)
        beside = frozenset(self._beside(record))
        if not record.declaration.declared().preloads:
            listed = listed or None  # its program may be one that the library is not loaded into
        return AskedProcess(instance, record.node, listed, mark=self._mark(record), not_its_own=beside)

    def _beside(self, record: ForeignRecord) -> Iterator[str]:
        """The nodes of its process that do not end with it: that of its container, and what is in that besides."""
        if record.container:
            yield record.container
        if not record.process:
            return
        if record.process_index is not None and self._page is not None:
            yield from self._page.ros_nodes(record.process_index) or ()
            yield from self._page.loaded_into(record.process_index, {record.index})
        for other in (agent.node.record for agent in self._agents.values()):
            if other.process == record.process and other.instance != record.instance:
                yield other.node

    def loads(self, record: ForeignRecord, now: bool) -> None:
        """A container is about to load the node of ``record``, or has answered that request."""
        if record.process_index is not None and self._page is not None:
            self._page.loads(record.process_index, record.index if now else None)

    async def is_loading(self, record: ForeignRecord) -> Callable[[], bool]:
        """Return what says whether the container of ``record`` is loading a node.

        Without the library in it, that is taken to be over when the node has had the time that it may take.
        """
        index = record.process_index
        if index is not None:
            with suppress(BackendError):
                page, _ = await self._opened(os.environ)
                return lambda: page.is_loading(index)
        over = time.monotonic() + endpoints_seconds(record.declaration.declared())
        return lambda: time.monotonic() < over

    async def leaves(self, record: ForeignRecord | None, now: bool = True) -> None:
        """Have nothing call a node any more that is to be unloaded; not ``now``: it stays, and is called again.

        Calls that have begun get ``_LAST_CALLS`` s, and as long as its `drain` where the library sees one of them: an
        executor with several threads would destroy the node during a call, with which the process ends. Its
        record says before that it is being removed: otherwise, if this manager died, the next one would keep a node
        that nothing calls.
        """
        if record is None:
            return
        if now:
            self._note_loaded(record, False)
        if record.index is not None:
            with suppress(BackendError):  # without the library here, it is unloaded all the same
                page = self._page or (await self._opened(os.environ))[0]
                page.leaves(record.index, now)
                if now:
                    await self._last_calls(page, record, record.index)
        if not now:
            self._note_loaded(record, True)

    async def _last_calls(self, page: Page, record: ForeignRecord, index: int) -> None:
        await asyncio.sleep(_LAST_CALLS)
        drain = record.declaration.declared().stop_times.drain
        over = time.monotonic() + drain
        while page.is_called(index):
            if time.monotonic() >= over:
                since = f"{drain:g} s (`drain`) after it was to be the last"
                what = f"a callback of {record.node} seems to run still, {since}"
                log.warning("%s; the node is unloaded all the same, which may end its container", what)
                return
            await asyncio.sleep(_LOOK)

    def _note_loaded(self, record: ForeignRecord, loaded: bool) -> None:
        """Write whether the container of ``record`` has the node, and is to keep it."""
        if (agent := self._agents.get(record.instance)) is not None and agent.node.record.uuid == record.uuid:
            agent.node.change_record(loaded=loaded)
            return
        try:
            replace(record, loaded=loaded).write(self._folder)
        except BackendError as error:
            log.error("%s", error)

    async def adopt(self, instance: str) -> None:
        """The process of an earlier manager runs: answer for it, if it has no agent inside it. Raises BackendError."""
        record = ForeignRecord.read(self._folder, instance)
        if record is not None and instance not in self._agents:
            if record.index is not None:
                try:
                    await self._opened(os.environ)
                except BackendError as error:
                    raise BackendError(f"{instance} cannot be answered for: {error}") from None
            await self._answer_once_known(record)
        self._relays.adopt(instance)

    async def _answer(self, record: ForeignRecord) -> None:
        gates, requests, component = None, None, record.declaration.declared()
        if record.index is not None and self._page is not None:
            requests = Gates(self._page, record.index, of_services(component))
            if component.preloads:
                gates = requests = Gates(self._page, record.index, of_topics(component))
        self._names.add(record.node)
        old = self._agents.get(record.replaces)
        before = None
        if self._graph is not None and record.predecessor:
            before = self._graph(record.predecessor, None if old is None else self._mark(old.node.record))
        follows = self._served is not None and bool(record.predecessor) and not record.welcomed
        agent = ForeignAgent(
            record,
            self._folder,
            gates,
            self._services_to(record),
            self._peers,
            None if (graph := self._graph) is None else lambda: graph(record.node, self._mark(record)),
            self._reported,
            served=None if (served := self._served) is None else lambda: self._served_now(served, record),
            before=before or (),
            predecessor=self._lifecycle_of_predecessor(record, old) if follows else None,
            managers=self._managers,
            states=self._states,
            requests=requests,
        )
        agent.node.keeps_name = lambda: self._can_share(record)
        self._agents[record.instance] = agent
        await agent.open(self._transport)

    def _services_to(self, record: ForeignRecord) -> NodeServices | None:
        """Return the services of the node of ``record``: of this one alone, where another may have its name."""
        if self._addressed is None or record.index is None or self._page is None:
            return self._services(record.node)
        return self._addressed(record.node, self._page, record.index, record.node != record.predecessor)

    def _lifecycle_of_predecessor(self, record: ForeignRecord, old: ForeignAgent | None) -> NodeServices | None:
        """The services of the node that is replaced; None of one that is no lifecycle node, and says no state."""
        if old is not None:
            return None if old.has_no_lifecycle() else self._services_to(old.node.record)
        return self._services(record.predecessor) if record.predecessor else None

    async def finish(self, instance: str) -> None:
        """Before its process is ended: requests to answer, and the last transitions of a lifecycle node."""
        if (agent := self._agents.get(instance)) is not None:
            try:
                await agent.finish()
            except CommandRefused as error:
                log.warning("%s; its process is ended all the same", error)

    def gone(self, instance: str) -> None:
        """Forget ``instance``, whose process has ended."""
        parameter_file(self._folder, instance).unlink(missing_ok=True)
        if (task := self._finding.pop(instance, None)) is not None:
            task.cancel()
        self._managers.starting.pop(instance, None)
        self._peers.nodes.pop(instance, None)
        if self._page is not None:
            forget_component(self._page, instance)
        self._relays.gone(instance)
        if (agent := self._agents.pop(instance, None)) is not None:
            record = agent.node.record
            in_background(agent.close(), self._closing)
        else:
            try:
                found = ForeignRecord.read(self._folder, instance)
            except BackendError as error:
                log.warning("%s; its part of the page stays taken", error)
                return
            if found is None:
                return
            record = found
        self.forget(record)

    def forget(self, record: ForeignRecord) -> None:
        """The node of ``record`` is not there any more: its part of the page is free."""
        record.delete(self._folder)
        self.discard(record)

    async def close(self) -> None:
        """Close the agents; their nodes keep running."""
        agents, self._agents = list(self._agents.values()), {}
        for task in list(self._finding.values()):
            task.cancel()
        await asyncio.gather(*(agent.close() for agent in agents), *self._closing)
        self._managers.close()


def _preloaded(started: StartedPrograms, page: Page, library: Path, index: int) -> dict[str, str]:
    """The environment of a process that is started as the node ``index`` of ``page``."""
    words = {PRELOAD: started.preloaded(library), ENV_PAGE: str(page.path.absolute()), ENV_NODE: str(index)}
    return {**started.environment, **words}
