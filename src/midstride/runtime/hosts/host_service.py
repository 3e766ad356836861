"""The host process: serves the back end of its host to the manager of one system, over a Unix socket.

It belongs to no login and to no connection: components keep running without it, without the manager, and without the
network between the two. Exits that happen while no manager is connected are kept for the next connection. It ends once
it watches no component and no manager has been connected for a while.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import shlex
import socket
import struct
import time
import uuid
from collections import deque
from pathlib import Path
from typing import Any, Final

import msgspec

from midstride.codec.writing import to_json
from midstride.errors import BackendError, CallTimeout, ProtocolError, StartFailed, Unreachable, internal_error
from midstride.model.command_files import command_files
from midstride.runtime.backend_protocol import Backend, Exited, Launch
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.hosts.call_forms import ExitedForm, HandleForm, OtherNodesForm, RemainingForm, kind_of
from midstride.runtime.hosts.host_order import HostOrder
from midstride.runtime.hosts.passed_on import pass_on, read_line
from midstride.runtime.hosts.wanted_connections import WantedConnections
from midstride.wire.frames import LONGEST_FRAME, PROTOCOL
from midstride.wire.transport import Connection

log = logging.getLogger(__name__)

# For how long a process that watches nothing waits for a manager (s).
IDLE: Final = 10.0
# How often the answers that need no waiting are looked at (s).
LOOK: Final = 0.5
# How often it is looked which nodes the processes have (s): that reads those of all processes of the host.
LOOK_AT_NODES: Final = 2.0
# How many exits are kept for the next connection: more than the components of a host.
KEPT_EVENTS: Final = 4096
# How long a component that is starting is waited for within one attempt to connect to it, and how often it is tried
# (s): so that an attempt costs the link one exchange.
LISTEN_SECONDS: Final = 1.0
_LISTEN_INTERVAL: Final = 0.005
_LONGEST_PIECE: Final = 4 * 1024 * 1024


class HostService:
    """``directory``: where programs are started. To be used on one event loop, with ``backend`` closed by the caller.

    ``order``: that of the manager. ``version``: that of Midstride.
    """

    def __init__(
        self, backend: Backend, order: HostOrder, *, directory: Path, logs: Path, version: str, idle: float = IDLE
    ) -> None:
        self._backend, self._order = backend, order
        self._directory, self._logs = directory, logs
        self._version, self._idle = version, idle
        self._uuid = uuid.uuid4().hex
        self._token: str | None = None
        self._running: set[str] = set()
        self._starting: dict[str, asyncio.Event] = {}  # set once the start is over
        self._answering: set[asyncio.Task[None]] = set()  # the calls in progress
        self._events: deque[frames.ExitFrame] = deque(maxlen=KEPT_EVENTS)
        self._number = 0
        self._manager: _Client | None = None
        self._wanted = WantedConnections()
        self._left_at = backend.clock.steady()
        self._others: dict[str, OtherNodesForm] = {}
        self._others_at = 0.0

    async def serve(self, path: Path) -> None:
        """Serve at ``path`` until nothing is left to watch. Raises BackendError where the back end cannot be opened."""
        await self.open()
        path.unlink(missing_ok=True)  # the caller holds the lock of the workspace
        before = os.umask(0o177)
        try:
            server = await asyncio.start_unix_server(self._accepted, path, limit=LONGEST_FRAME)
        finally:
            os.umask(before)
        try:
            await self.watch()
        finally:
            server.close()
            path.unlink(missing_ok=True)

    async def open(self) -> None:
        """Begin to watch components. Raises BackendError where the back end cannot be opened."""
        await self._backend.open(self._exited)

    async def watch(self) -> None:
        """Return once nothing is left to watch: until then, tell the manager what changes."""
        clock = self._backend.clock
        while self._manager is not None or self._running or clock.steady() - self._left_at < self._idle:
            await asyncio.sleep(LOOK)
            if self._manager is not None:
                self._manager.push(self._state())

    # -- connections ---------------------------------------------------------------------------------------

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if _user(writer.get_extra_info("socket")) in (0, os.getuid()):
            await self.accepted(reader, writer)
        else:
            writer.close()

    async def accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection to its end."""
        try:
            await self._serve_one(reader, writer)
        except (OSError, ProtocolError, ValueError, asyncio.CancelledError):
            pass  # the other end is gone, or no manager
        finally:
            writer.close()

    async def _serve_one(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        greeting = frames.HostGreeting(
            protocol=frames.HOST_PROTOCOL,
            version=self._version,
            control=PROTOCOL,
            system=self._order.system,
            host=self._order.host,
            uuid=self._uuid,
            pid=os.getpid(),
            running=len(self._running),
            variables=self._order.variables,
            middleware_settings=self._order.middleware_settings,
        )
        await frames.write(writer, greeting)
        line = await _line(reader)
        if line is None:
            return
        hello = frames.decode_from_manager(line)
        if isinstance(hello, frames.ComponentHello) and hello.elsewhere:
            await self._wanted.pass_on(hello.instance, self._manager, reader, writer)
        elif isinstance(hello, frames.ComponentHello):
            await self._pass_on(hello.instance, reader, writer)
        elif isinstance(hello, frames.BroughtHello):
            await self._wanted.brought(hello, reader, writer)
        elif isinstance(hello, frames.ManagerHello):
            await self._serve_manager(hello, reader, writer)
        elif isinstance(hello, frames.ReaderHello):
            client = _Client(writer)
            client.push(frames.Accepted())
            await self._answer_calls(client, reader, calls.READING)

    async def _pass_on(self, instance: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            connection = await self._connect(instance)
        except Unreachable as error:
            await frames.write(writer, frames.Accepted(refused=str(error), gone=True))
            return
        except CallTimeout as error:
            await frames.write(writer, frames.Accepted(refused=str(error)))
            return
        try:
            await frames.write(writer, frames.Accepted())
            await pass_on(connection, reader, writer)
        finally:
            connection.close()

    async def _connect(self, instance: str) -> Connection:
        """A connection to a component here, which may be starting. Raises Unreachable, CallTimeout."""
        transport, deadline = self._backend.transport, self._backend.clock.steady() + LISTEN_SECONDS
        while True:
            try:
                return await transport.connect(transport.address(instance))
            except Unreachable:
                if instance not in self._running or self._backend.clock.steady() >= deadline:
                    raise
            await asyncio.sleep(_LISTEN_INTERVAL)

    async def _serve_manager(
        self, hello: frames.ManagerHello, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        if self._running and self._token not in (None, hello.token):
            words = (
                f"its host process {os.getpid()} watches {len(self._running)} components of another start of "
                f"{self._order.system}, whose manager's state is gone: end them there (`kill {os.getpid()}`, then the "
                "components), or use another `folder`"
            )
            await frames.write(writer, frames.Accepted(refused=words))
            return
        self._token = hello.token
        if self._manager is not None:  # of the same system: a connection that has not been noticed to be dead
            self._manager.close()
        manager = self._manager = _Client(writer)
        try:
            missed = hello.seen if hello.uuid == self._uuid else self._number
            manager.push(frames.Accepted(seen=missed))
            for event in self._events:
                if event.number > missed:
                    manager.push(event)
            manager.push(self._state())
            await self._answer_calls(manager, reader)
        finally:
            manager.close()
            if self._manager is manager:
                self._manager, self._left_at = None, self._backend.clock.steady()

    async def _answer_calls(
        self, client: _Client, reader: asyncio.StreamReader, allowed: tuple[type, ...] = (object,)
    ) -> None:
        while (line := await _line(reader)) is not None:
            frame = frames.decode_from_manager(line)
            if not isinstance(frame, frames.CallFrame) or not isinstance(frame.call, allowed):
                raise ProtocolError("not a call, or one that the client may not make")
            task = asyncio.get_running_loop().create_task(self._answer(client, frame))  # it continues without the link
            self._answering.add(task)
            task.add_done_callback(self._answering.discard)

    async def _answer(self, client: _Client, frame: frames.CallFrame) -> None:
        try:
            result = frames.ResultFrame(number=frame.number, result=msgspec.Raw(to_json(await self._call(frame.call))))
        except BackendError as error:
            result = frames.ResultFrame(number=frame.number, failed=str(error), kind=kind_of(error))
        except Exception as error:  # a fault of ours must still end in an answer
            log.exception("the call %s failed", type(frame.call).__name__)
            result = frames.ResultFrame(number=frame.number, failed=internal_error(error), kind=BackendError.__name__)
        if client is self._manager:
            client.push(self._state())
        elif isinstance(frame.call, calls.End) and result.failed is None:  # the manager has another connection now
            name = frame.call.instance
            self._exited(Exited(name, None, because=f"{name} was ended, as it was asked to before the link broke"))
        client.push(result)

    # -- calls ---------------------------------------------------------------------------------------------

    async def _call(self, call: calls.HostCall) -> Any:
        backend = self._backend
        match call:
            case calls.Start():
                return await self._start(call)
            case calls.Describe():
                return self._describe(call.launch.launch(self._directory))
            case calls.Adopt() if call.handle.instance in self._running:
                return True
            case calls.Adopt():
                runs = await backend.adopt(call.handle.handle(""))
                if runs:
                    self._running.add(call.handle.instance)
                return runs
            case calls.End():
                if (starting := self._starting.get(call.instance)) is not None:  # nobody waits for it
                    await starting.wait()
                killed = await backend.end(call.instance, call.stop.times())
                self._running.discard(call.instance)
                return [RemainingForm.of(each) for each in killed]
            case calls.EndOrphans():
                return await backend.end_orphans(call.token, frozenset(call.known), call.stop.times())
            case calls.KeepSpares():
                return backend.keep_spares(call.count, call.token)
            case calls.ForgetName():
                return backend.disconnected(call.instance)
            case calls.PublisherIds():
                ids = await backend.publisher_ids(call.topic, call.instance)
                return calls.KnownIds(ids=None if ids is None else sorted(ids))
            case calls.LingeringReaders():
                return await backend.lingering_readers(call.topic)
            case calls.ListLogs():
                return {path.name: path.stat().st_size for path in self._logs.glob("*.log")}
            case calls.ReadLog():
                return await asyncio.to_thread(self._read_log, call)
            case calls.ReadClock():
                return time.time_ns()

    def _describe(self, launch: Launch) -> list[str]:
        command = list(self._backend.describe(launch).command)
        for file in command_files(launch.arguments) if launch.package is None else ():
            if not (path := self._directory / file).exists():
                command_line = shlex.join(launch.arguments)
                raise StartFailed(
                    f"there is no file {path} for `{command_line}`: copy it to there, or correct `run` or `folder`"
                )
        return command

    async def _start(self, call: calls.Start) -> HandleForm:
        launch = call.launch.launch(self._directory)
        if (removed := self._removed()) is not None:
            raise StartFailed(f"{launch.instance}: {removed}")
        if launch.instance in self._starting:
            raise StartFailed(f"{launch.instance}: an earlier start of that name has not ended yet")
        self._running.add(launch.instance)  # so that this process does not end meanwhile
        self._starting[launch.instance] = over = asyncio.Event()
        try:
            return HandleForm.of(await self._backend.start(launch))
        except BaseException:
            self._running.discard(launch.instance)
            raise
        finally:
            del self._starting[launch.instance]  # of no other start, see above
            over.set()

    def _read_log(self, call: calls.ReadLog) -> calls.LogPiece:
        path = self._logs / call.file
        if path.parent != self._logs or path.is_symlink():
            raise BackendError(f"{call.file!r} is no log")
        try:
            with path.open("rb") as file:
                file.seek(max(0, call.begin))
                return calls.LogPiece(content=file.read(max(0, min(call.longest, _LONGEST_PIECE))))
        except FileNotFoundError:
            return calls.LogPiece(content=b"")
        except OSError as error:
            raise BackendError(f"{path} cannot be read: {error.strerror or error}") from None

    def _removed(self) -> str | None:
        """The reason why nothing can be started any more, where a folder was removed from below the running system."""
        for folder, first in ((self._directory, "put its programs back, then "), (self._logs, "")):
            if not os.path.isdir(folder):  # that of Path raises where a network file system does not answer
                return (
                    f"the folder {folder} is not there any more, or cannot be read, so changes fail: "
                    f"{first}`midstride down` and `midstride up`"
                )
        return None

    # -- what happens --------------------------------------------------------------------------------------

    def _exited(self, exited: Exited) -> None:
        self._running.discard(exited.instance)
        self._number += 1
        event = frames.ExitFrame(number=self._number, exited=ExitedForm.of(exited))
        self._events.append(event)
        if self._manager is not None:
            self._manager.push(event)

    def _state(self) -> frames.StateFrame:
        backend, running, now = self._backend, sorted(self._running), self._backend.clock.steady()
        if backend.shares_processes and now - self._others_at > LOOK_AT_NODES:
            self._others_at = now
            with contextlib.suppress(BackendError):
                found = backend.other_nodes(running)
                self._others = {name: OtherNodesForm.of(each) for name, each in found.items()}
        return frames.StateFrame(
            stopped=[name for name in running if backend.is_stopped(name)],
            hanging=backend.hanging(),
            unwritten=self._removed() or backend.unwritten(),
            others={name: each for name, each in self._others.items() if name in self._running},
            spares=backend.spares(),
        )


class _Client:
    """The connection of a manager or of a reader. One that does not read what it is sent is closed."""

    _LONGEST: Final = 4 * frames.LONGEST_HOST_FRAME

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        self._state: frames.StateFrame | None = None

    def push(self, frame: Any) -> None:
        """Send a frame without waiting; a state that has not changed is not sent again."""
        if isinstance(frame, frames.StateFrame):
            if frame == self._state:
                return
            self._state = frame
        if self._writer.is_closing():
            return
        self._writer.write(frames.encode(frame) + b"\n")
        if self._writer.transport.get_write_buffer_size() > self._LONGEST:
            self.close()

    def close(self) -> None:
        self._writer.close()


async def _line(reader: asyncio.StreamReader) -> bytes | None:
    return await read_line(reader, frames.LONGEST_HOST_FRAME)


def _user(connection: socket.socket) -> int:
    """The user at the other end, as the kernel knows it: with SSH, the one that has logged in."""
    uid: int = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[1]
    return uid
