"""The part of the back end for ROS 2 that is about processes of containers which several instances share.

A request to load a node may stay without an answer: then the node may be there some time, so nothing else is loaded
into that process, and its role is not started beside it. Once it is there, it is unloaded.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
import logging
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Container, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from midstride.ament_index import component_library
from midstride.backends import processes
from midstride.backends.processes import ProcessBackend
from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.container_services import (
    ContainerServices,
    LateResponse,
    LoadUnanswered,
    UnloadUnanswered,
)
from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.ros2.manager.graph import Graph
from midstride.backends.ros2.manager.node_owner import node_owner
from midstride.backends.ros2.manager.own_names import StartName
from midstride.backends.ros2.manager.shared_processes import KnownNames, SharedProcess, SharedProcesses
from midstride.backends.ros2.manager.start_arguments import StartArguments
from midstride.errors import BackendError, EndUnknown, NodeError, StartFailed
from midstride.foreign.preloading import StartedPrograms
from midstride.foreign.record import ForeignRecord
from midstride.model import wording
from midstride.model.component import DEFAULT_STOP, KILL_AT_ONCE, ComponentSpec, StopTimes
from midstride.model.instance_names import full_name
from midstride.runtime.backend_protocol import Exited, Handle, Launch, RemainingProcess
from midstride.runtime.process.child_process import find
from midstride.runtime.process.family import mark_of
from midstride.wire.environment import ENV_INSTANCE

# How long a container may take to say what it has loaded, once it has not loaded a node (s).
_UNLOAD: Final = 2.0
# How long after that it is asked again to unload a node (s): at first, and at most; each pause is twice the last one.
_AGAIN: Final = 1.0
_LONGEST_PAUSE: Final = 60.0

log = logging.getLogger(__name__)


class ContainerBackend(ProcessBackend):
    """Starts, adopts and ends instances that share a process, beside those that have one for themselves."""

    _on_exit: Callable[[Exited], None]
    _node: Any
    _context: Any
    _graph: Graph
    _arguments: StartArguments
    _shared: SharedProcesses
    _foreign_nodes: ForeignNodes

    # -- start ---------------------------------------------------------------------------------------------

    @asynccontextmanager
    async def _or_ended(self, launch: Launch, end: Callable[[], Awaitable[object]]) -> AsyncIterator[None]:
        """Have ``end`` called where nothing can answer for what was started. Raises StartFailed for a NodeError."""
        try:
            yield
        except BaseException as error:
            await end()
            if isinstance(error, NodeError):
                raise StartFailed(f"{launch.instance}: {error}") from error
            raise

    async def _start_shared(
        self,
        launch: Launch,
        component: ComponentSpec,
        name: StartName,
        command: Sequence[str],
        programs: StartedPrograms,
    ) -> Handle:
        """Load the node into the process of its container, which is started where it does not run."""
        async with self._shared.changing(launch.process):
            shared = self._shared.get(launch.process)
            if shared is None:
                shared = await self._start_container(launch, component, name, command, programs)
            elif launch.load is not None:
                shared.require_answering(launch.instance)
                if not launch.returns:  # it has had the node, and a roll-back means the old one
                    library = component_library(component.package or "", launch.load.plugin, os.environ)
                    shared.require_current(launch.instance, Path(library))
            shared.members.add(launch.instance)
        self._processes[launch.instance] = shared.process

        async def end() -> None:
            await self.end(launch.instance, KILL_AT_ONCE if len(shared.members) == 1 else DEFAULT_STOP)

        async with self._or_ended(launch, end):
            if not name.shared:
                self._graph.starts(name.full)
            _, record = await self._foreign_nodes.prepare(launch, component, name.full, programs, shared)
            if launch.instance not in shared.members:
                self._foreign_nodes.discard(record)
                raise StartFailed(f"{launch.instance}: {shared.name} has ended meanwhile")
            process = shared.process
            log_file = None if process.log is None else str(process.log)
            handle = Handle(launch.instance, process.pid, process.started, log_file)
            request = self._arguments.load_request(launch, component, name)
            await self._foreign_nodes.started(record, handle, request)
        return handle

    async def _start_container(
        self,
        launch: Launch,
        component: ComponentSpec,
        name: StartName,
        command: Sequence[str],
        programs: StartedPrograms,
    ) -> SharedProcess:
        """Start the process of the container that a launch is for, with nothing loaded into it."""
        own = full_name(launch.process)
        if self._graph.has(own):
            raise StartFailed(
                f"{launch.instance}: a node {own} is running already, and its container is to have that name: "
                f"{node_owner(self._graph, own, self._control)}"
            )
        self._graph.starts(own)
        variables, index = await self._foreign_nodes.prepare_shared(launch, component, programs)
        try:
            of_container = replace(launch, instance=launch.process, node=launch.process)
            variables |= processes.identity(of_container, self.name, self._control)
            arguments = self._arguments.of(launch, component, name)
            handle = await self._spawn(of_container, own, (*command, *arguments), variables)
        except BaseException:
            self._foreign_nodes.discard_shared(launch.process, index)
            raise
        process = self._processes.pop(handle.instance)
        return self._share(SharedProcess(launch.process, process, index))

    def _share(self, shared: SharedProcess) -> SharedProcess:
        """Watch a process with several instances: all of them end with it."""

        def exited(status: int | None) -> None:
            self._shared_has_ended(shared, wording.exited(status))

        shared.process.on_exit = exited
        return self._shared.add(shared)

    # -- loading -------------------------------------------------------------------------------------------

    async def _load(self, record: ForeignRecord, request: LoadRequest, timeout: float) -> None:
        shared = self._shared.of(record.instance)
        services, late = ContainerServices(self._node, request.container), None
        try:
            async with contextlib.nullcontext() if shared is None else shared.loading:
                if shared is not None:
                    shared.require_answering(record.instance)
                    shared.loads = record.instance
                self._foreign_nodes.loads(record, now=True)
                try:
                    await services.load(request, timeout)
                except LoadUnanswered as error:
                    if shared is None:
                        error.late.cancel()
                    else:
                        late = error.late
                        self._await_late(shared, record, services, late)
                    raise
                finally:
                    if shared is not None:
                        shared.loads = ""
                    if late is None:
                        self._foreign_nodes.loads(record, now=False)
        finally:
            if late is None and self._context is not None:
                services.close()

    def _await_late(
        self,
        shared: SharedProcess,
        record: ForeignRecord,
        services: ContainerServices,
        late: LateResponse,
    ) -> asyncio.Task[None]:
        """Remember that a request to load is not answered. Once the node is there, it is unloaded, and forgotten."""
        shared.unanswered[record.instance] = record
        return shared.wait(self._unload_late(shared, record, services, late))

    async def _unload_late(
        self,
        shared: SharedProcess,
        record: ForeignRecord,
        services: ContainerServices,
        late: LateResponse,
    ) -> None:
        try:
            is_there, pause = await late is None, _AGAIN
            while is_there:
                try:
                    async with shared.loading:
                        await self._foreign_nodes.leaves(record)
                        await services.unload(record.node, _UNLOAD)
                    is_there = False
                except BackendError as error:
                    if pause == _AGAIN:  # once
                        again = f"{shared.name} is asked again until it has unloaded it"
                        log.warning("%s is in it, and is being removed: %s; %s", record.node, error, again)
                    await asyncio.sleep(pause)
                    pause = min(2 * pause, _LONGEST_PAUSE)
        except BackendError as error:  # it cannot be asked any more
            log.error("%s: %s", record.instance, error)
            return
        finally:
            late.cancel()
            if self._context is not None:
                services.close()
        if shared.unanswered.pop(record.instance, None) is not None:
            log.warning("%s has answered the request to load %s, which is not there", shared.name, record.node)
            self._foreign_nodes.loads(record, now=False)
            self._foreign_nodes.forget(record)

    async def _take_back(self, shared: SharedProcess, record: ForeignRecord) -> None:
        """Unload a node that no instance has, and that may be there only later: it waits for a while."""
        services = ContainerServices(self._node, full_name(shared.name))
        known = services.until_known(record.node, await self._foreign_nodes.is_loading(record))
        late: LateResponse = asyncio.ensure_future(known)
        await asyncio.wait({self._await_late(shared, record, services, late)}, timeout=_UNLOAD)

    async def _not_loaded(self, instance: str, why: str) -> None:
        """End a container whose node could not be loaded: it would be a process without the node.

        One that others share goes on; what it may have loaded all the same is unloaded.
        """
        if (process := self._processes.get(instance)) is None:
            return
        shared, record = self._shared.of(instance), self._foreign_nodes.record_of(instance)
        if shared is not None and instance in shared.leaving:
            return  # it is being ended
        hangs = shared is not None and instance in shared.unanswered
        if shared is None or len(shared.members) == 1:
            await self.end(instance, KILL_AT_ONCE)
        else:
            if record is not None and record.loaded:
                try:
                    await self._unload(shared, instance, _UNLOAD)
                except BackendError as error:
                    log.error("%s", error)
                    shared.wait_no_more(instance)
                    await self._take_back(shared, record)
            shared.members.discard(instance)
            self._processes.pop(instance, None)
            if instance in shared.unanswered:
                why = f"{why}. {shared.why_busy(instance)}"
            else:
                self._foreign_nodes.gone(instance)
        self._on_exit(Exited(instance, None, process.last_words(), f"{instance} cannot be started: {why}", hangs))

    # -- adoption ------------------------------------------------------------------------------------------

    async def _adopt_shared(self, handle: Handle) -> bool | None:
        """Take over a node that was loaded into a container that others share; whether it runs, None for any other."""
        record = self._foreign_nodes.record_of(handle.instance)
        if record is None or not record.process or handle.pid is None or handle.started is None:
            return None
        shared = self._shared.get(record.process)
        if shared is None:
            log_file = None if handle.log is None else Path(handle.log)
            process = find(handle.pid, handle.started, ENV_INSTANCE, record.process, log_file)
            if process is None:
                return False
            process.mark = mark_of(process.pid)
            self._watch(record.process, process)
            shared = self._share(
                SharedProcess(record.process, self._processes.pop(record.process), record.process_index)
            )
        elif (shared.process.pid, shared.process.started) != (handle.pid, handle.started):
            return False
        if not record.loaded:
            if handle.instance not in shared.unanswered:
                await self._take_back(shared, record)
            return False
        shared.members.add(handle.instance)
        self._processes[handle.instance] = shared.process
        return shared.process.running

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        """Nodes that an earlier manager had loaded into a container, and could not record, are unloaded as well."""
        for shared in self._shared.processes():
            if not shared.members:
                await shared.process.end(KILL_AT_ONCE)
                self._shared_has_ended(shared, "had no other node")
                continue
            for record in self._foreign_nodes.records():
                same = (record.process, record.pid) == (shared.name, shared.process.pid)
                if same and record.instance not in {*shared.members, *shared.unanswered}:
                    await self._take_back(shared, record)
        return await super().end_orphans(token, KnownNames((known, {*self._shared})), stop)

    def hanging(self) -> list[str]:
        return [words for shared in self._shared.processes() for words in shared.hanging()]

    # -- end -----------------------------------------------------------------------------------------------

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        shared = self._shared.of(instance)
        if stop.longest:
            if shared is not None and not stop.whole:
                await self._require_answer(shared, instance, stop.longest)
            await self._foreign_nodes.finish(instance)
        if (shared := self._shared.of(instance)) is None:
            if self._shared.is_unanswered(instance):  # it ends with its container
                return []
            return await super().end(instance, stop)
        async with self._shared.changing(shared.name):  # no node comes meanwhile
            if self._shared.get(shared.name) is not shared:  # it has ended meanwhile
                return []
            if not shared.members - {instance} or not stop.longest:
                killed = await super().end(instance, stop)
                shared.members.discard(instance)
                shared.leaving.discard(instance)
                self._shared_has_ended(shared, f"was killed with {instance}, which did not answer")
                return killed
            shared.members.discard(instance)
            shared.leaving.add(instance)
        await self._unload(shared, instance, stop.longest, whole=stop.whole)
        return []

    async def _require_answer(self, shared: SharedProcess, instance: str, longest: float) -> None:
        """Raises BackendError, before anything of its node ends, where a process that is to stay does not answer."""
        if not shared.members - {instance} or instance in {*shared.unanswered, *shared.unloads}:
            return
        services = ContainerServices(self._node, full_name(shared.name))
        try:
            await services.require_answer(longest)
        except BackendError as error:
            if shared.process.running:
                raise BackendError(shared.why_it_goes_on(instance, str(error))) from None
        finally:
            if self._context is not None:
                services.close()

    async def _unload(self, shared: SharedProcess, instance: str, longest: float, *, whole: bool = False) -> None:
        """End one instance of a process that stays. Raises BackendError where it keeps running, EndUnknown if it may.

        Where the ``whole`` process is to end, one that it does not unload ends with the last of the others instead, and
        nothing is asked of a container that has not answered such a request.
        """
        record = self._foreign_nodes.record_of(instance)  # also of one that nothing answers for yet
        node = full_name(instance) if record is None else record.node
        shared.members.discard(instance)
        shared.leaving.add(instance)
        stuck, asked_before = shared.is_stuck, instance in shared.unloads
        shared.wait_no_more(instance)
        services = ContainerServices(self._node, full_name(shared.name))
        try:
            async with shared.loading:
                if instance in shared.unanswered:  # it ends with its container
                    self._processes.pop(instance, None)
                    return
                await self._foreign_nodes.leaves(record)
                if whole and stuck and record is not None:
                    self._ends_with_all(shared, record)
                    return
                unloading = asyncio.ensure_future(services.unload(node, longest))
                over = asyncio.ensure_future(shared.process.wait())
                try:
                    await asyncio.wait((unloading, over), return_when=asyncio.FIRST_COMPLETED)
                    if unloading.done():
                        unloading.result()
                finally:
                    unloading.cancel()
                    over.cancel()
        except BackendError as error:
            if shared.process.running and whole and record is not None:
                log.warning("%s: %s; it ends with %s, as all of that do", instance, error, shared.name)
                self._ends_with_all(shared, record)
                return
            if shared.process.running:
                shared.members.add(instance)
                if asked_before or isinstance(error, UnloadUnanswered):
                    self._await_unloaded(shared, instance, node)
                    raise EndUnknown(shared.why_unknown(instance, str(error))) from None
                await self._foreign_nodes.leaves(record, now=False)
                raise BackendError(shared.why_it_goes_on(instance, str(error))) from None
        finally:
            if instance not in shared.left:
                shared.leaving.discard(instance)
            if self._context is not None:
                services.close()
        self._processes.pop(instance, None)
        self._foreign_nodes.gone(instance)

    def _ends_with_all(self, shared: SharedProcess, record: ForeignRecord) -> None:
        """Have the instance end with its process, as all others of it do; its record is kept until then."""
        shared.left[record.instance] = record
        self._processes.pop(record.instance, None)

    def _await_unloaded(self, shared: SharedProcess, instance: str, node: str) -> None:
        """Have the instance count as one that has exited, once its container does not have the node any more."""

        async def wait() -> None:
            services = ContainerServices(self._node, full_name(shared.name))
            try:
                await services.until_gone(node)
            finally:
                if self._context is not None:
                    services.close()
            shared.unloads.pop(instance, None)
            shared.members.discard(instance)
            self._processes.pop(instance, None)
            self._foreign_nodes.gone(instance)
            words = f"{instance} has ended: {shared.name} has unloaded it after all, as it was asked to"
            self._on_exit(Exited(instance, None, "", words))

        shared.unloads[instance] = shared.wait(wait())

    def _shared_has_ended(self, shared: SharedProcess, how: str) -> None:
        if not self._shared.remove(shared):
            return
        members = sorted({*shared.members, *shared.leaving})  # those that were leaving are not missed
        ended = [shared.left_by(each, how) for each in sorted(shared.members)]
        shared.members.clear()
        shared.leaving.clear()
        for task in shared.tasks:
            task.cancel()
        for instance in members:
            self._forget(instance, shared.process)
            self._gone(instance)
        for record in (*shared.unanswered.values(), *shared.left.values()):
            self._foreign_nodes.forget(record)
        shared.unanswered.clear()
        shared.left.clear()
        self._foreign_nodes.discard_shared(shared.name, shared.index)
        if self._context is not None:
            self._graph.died(full_name(shared.name))
        for each in ended:
            self._on_exit(each)

    @abc.abstractmethod
    def _gone(self, instance: str) -> None:
        """An instance has ended: nothing answers for it any more."""
