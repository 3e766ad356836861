"""The manager's side on ROS 1: see :class:`midstride.runtime.backend.Backend`.

It is a node of ROS 1 by speaking the protocols itself (:mod:`.rpc`, :mod:`.tcpros`), on the manager's
event loop: no ROS library is imported, no call is without a deadline, and no thread is held by one.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from midstride.backends import common
from midstride.backends.ros1 import launching, master_process, names
from midstride.backends.ros1.announcement_listener import AnnouncementListener
from midstride.backends.ros1.command_client import Caller
from midstride.backends.ros1.master import Master
from midstride.errors import BackendError, StartFailed, Unreachable
from midstride.runtime.backend import Endpoints, Exited, Handle, Launch
from midstride.runtime.clock import Clock, SystemClock
from midstride.runtime.process import Process, find, spawn
from midstride.runtime.reaper import Reaper
from midstride.runtime.timeouts import within
from midstride.wire.environment import ENV_INSTANCE, Announcement, Command, Reply

# How long taking back what a dead node has registered may delay the news of its death (s).
_TIDY: Final = 1.0
# How long a component of an earlier manager may take to be found (s).
_FIND: Final = 2.0


class Ros1Backend:
    """To be opened, used and closed on one event loop."""

    name = "ros1"

    def __init__(self, *, logs: Path | None = None, guardian: Reaper | None = None) -> None:
        self.clock: Clock = SystemClock()
        self.started_master = False
        self._logs = logs
        self._guardian = guardian
        self._children = common.Children(guardian, self._exited)
        self._listener: AnnouncementListener | None = None
        self._tidying: set[asyncio.Task[None]] = set()

    # -- joining and leaving -------------------------------------------------------------------------

    async def open(self, on_event: Callable[[Announcement | Exited], None]) -> None:
        uri = launching.master_uri(os.environ)
        host = launching.own_host(os.environ, uri)
        self._on_event = on_event
        self._master = Master(uri, f"{names.MANAGER}{os.getpid()}_{time.time_ns() // 1_000_000}")
        self._caller = Caller(self._master)
        self.started_master = await master_process.ensure(self._master, self._folder(), self._guardian)
        try:
            await master_process.forget_dead_managers(self._master)
            listener = AnnouncementListener(self._master, names.ANNOUNCEMENT, self._on_backend_event)
            await listener.open(host)
        except BaseException:
            if self.started_master:
                await self._release_master()
            raise
        self._listener = listener

    async def close(self) -> None:
        """Leave; the components go on, and the master with them. Where none is left, what was started of it ends."""
        any_left = len(self._children) > 0
        self._children.close()
        listener, self._listener = self._listener, None
        if listener is None:
            return
        await asyncio.gather(*self._tidying, return_exceptions=True)
        await listener.close()
        if not any_left:
            await self._release_master()

    async def _release_master(self) -> None:
        with contextlib.suppress(BackendError):  # a master that does not answer is left alone
            await master_process.release(self._master, self._guardian)

    # -- components ----------------------------------------------------------------------------------

    async def start(self, launch: Launch) -> Handle:
        master = self._joined()
        node = names.full(launch.instance, launch.namespace)
        command = common.command(launch.arguments, launch.directory, os.environ, launching.require_interpreter)
        if await master.holder(node):
            raise StartFailed(
                f"{launch.instance}: a node {node} is running already, and a second one of its name would end it; "
                "end it yourself, or use another name"
            )
        environment = {
            **launching.environment(os.environ, master.uri),
            **common.identity(launch, self.name),
            launching.NAMESPACE: names.split(launch.instance, launch.namespace)[1],
        }
        log = self._folder(launch.token) / f"{node.strip('/').replace('/', '.')}.log"
        process = spawn(command, launch.directory, environment, log)
        self._children.take(launch.instance, process)
        return Handle(launch.instance, process.pid, process.started, str(log))

    async def adopt(self, handle: Handle) -> bool:
        instance, service = handle.instance, names.command_service(names.full(handle.instance))
        if instance in self._children:
            return True
        if handle.pid is None or handle.started is None:
            return await self._caller.ready(service, _FIND)
        log = None if handle.log is None else Path(handle.log)
        process = find(handle.pid, handle.started, ENV_INSTANCE, instance, log)
        if process is None:
            await self._tidy(instance)
            return False
        self._children.take(instance, process)
        if not await self._caller.ready(service, _FIND) and process.running:
            master = launching.master_of(process.pid)
            hint = f": it runs with {launching.MASTER_URI}={master}" if master != self._joined().uri else ""
            raise Unreachable(
                f"{instance} runs (process {process.pid}), but its command service is not to be found{hint}"
            )
        return process.running

    async def call(self, instance: str, command: Command, timeout: float) -> Reply:
        self._joined()
        calling = self._caller.call(names.command_service(names.full(instance)), command, timeout)
        return await self._children.while_running(instance, command.op, calling)

    async def end(self, instance: str, grace: float) -> None:
        if await self._children.end(instance, grace):
            await self._tidy(instance)

    def _exited(self, instance: str, status: int | None, process: Process) -> None:
        """Clean first, then tell: whoever hears of it may start another on the very same port."""

        async def tidy_and_tell() -> None:
            await self._tidy(instance)
            self._on_event(Exited(instance, status, process.last_words()))

        task = asyncio.get_running_loop().create_task(tidy_and_tell())
        self._tidying.add(task)
        task.add_done_callback(self._tidying.discard)

    async def _tidy(self, instance: str) -> None:
        """Take back what a component that has ended may have left with the master; that must not take long."""
        self._caller.forget(names.command_service(names.full(instance)))
        with contextlib.suppress(BackendError, asyncio.TimeoutError):
            async with within(_TIDY):
                await self._joined().forget(names.full(instance))

    def _folder(self, token: str = "") -> Path:
        """Where logs go."""
        if self._logs is not None:
            return self._logs
        return _log_folder() / "midstride" / token[:12]

    # -- the graph -----------------------------------------------------------------------------------

    async def endpoints(self) -> Endpoints:
        state = await self._joined().state()
        sides = [
            tuple(
                sorted(
                    (node, topic)
                    for topic, nodes in kind.items()
                    if not (names.is_ours(topic) or topic == "/rosout")
                    for node in nodes
                )
            )
            for kind in (state.publishers, state.subscribers)
        ]
        nodes = frozenset(node for node in state.nodes() if not names.is_ours(node))
        return Endpoints(nodes, sides[0], sides[1])

    # -- what is heard -------------------------------------------------------------------------------

    def _on_backend_event(self, text: str) -> None:
        try:
            announcement = Announcement.from_json(text)
        except (ValueError, KeyError, TypeError):
            return  # anybody can write to a topic
        self._on_event(announcement)

    def _joined(self) -> Master:
        if self._listener is None:
            raise Unreachable("the back end is not open")
        return self._master


def _log_folder() -> Path:
    """Where ROS 1 puts logs."""
    if folder := os.environ.get("ROS_LOG_DIR"):
        return Path(folder)
    home = os.environ.get("ROS_HOME") or os.path.expanduser("~/.ros")
    return Path(home) / "log" if os.path.isabs(home) else Path(tempfile.gettempdir()) / "ros-log"
