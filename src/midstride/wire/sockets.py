"""Unix sockets, one for each component, in the folder ``components`` of the system's workspace.

The folder is the access control: mode 0700 unless its owner opens it to others. A component accepts connections of
its own user, of root, and of the user who owns the folder. A socket's path may have 107 bytes on Linux; here sockets
are reached through file descriptors, so neither the folder's path nor a component's name is limited by that.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
import socket
import stat
import struct
import sys
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, unquote

from midstride.errors import CallTimeout, NodeError, ProtocolError, Unreachable
from midstride.wire.cut_locks import FileLock
from midstride.wire.frames import LONGEST_FRAME
from midstride.wire.other_hosts import OtherHostAddress, introduce
from midstride.wire.transport import FORWARDED, Serve, StopListening

_SCHEME: Final = "unix:"
_SUFFIX: Final = ".sock"
_BACKLOG: Final = 16
_LOCKS: Final = ".locks"
# How long the lock of the folder may be held by a process that takes a name (s).
LOCK_TIMEOUT: Final = 2.0
# For how long, and how often, a connection is tried again that the kernel refuses for now (s).
CONNECT_TIMEOUT: Final = 0.5
_CONNECT_INTERVAL: Final = 0.02
# How it refuses one for lack of descriptors or memory, here or on the machine: this says nothing about the other end.
_SHORTAGES: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS})
# From Python 3.13 on, asyncio looks for the socket's file to remove it. It was bound to a name in /proc/self/fd that
# may be another file's by now; `listen` removes it itself.
_KEEPING_THE_FILE: Final[dict[str, Any]] = {"cleanup_socket": False} if sys.version_info >= (3, 13) else {}


class SocketConnection:
    """Implements :class:`midstride.wire.transport.Connection`: a frame is a line."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer
        self._sending = asyncio.Lock()
        # Nothing is buffered here: what the other end does not read is kept, and given up, by the sender.
        writer.transport.set_write_buffer_limits(0)

    @property
    def peer(self) -> int | None:
        try:
            pid = _credentials(self._writer.get_extra_info("socket"))[0]  # OSError: the connection is closed here
            with open(f"/proc/{pid}/status", "rb") as file:  # the kernel cuts names within a character
                return next(int(line.split()[-1]) for line in file if line.startswith(b"NSpid:"))
        except (OSError, StopIteration):
            return None

    async def send(self, frame: bytes) -> None:
        try:
            async with self._sending:
                await self._writer.drain()  # of a send that was cancelled before the kernel had taken all of it
                self._writer.write(frame + b"\n")
                await self._writer.drain()
        except (OSError, RuntimeError) as error:  # RuntimeError: it was closed here
            raise Unreachable(f"the control connection is closed: {error}") from None

    async def receive(self) -> bytes | None:
        try:
            line = await self._reader.readline()
        except ValueError:
            raise ProtocolError(f"it sent a frame of more than {LONGEST_FRAME} bytes") from None
        except OSError:
            return None
        return line[:-1] if line.endswith(b"\n") else None  # half a line: the other end died while it wrote

    def close(self) -> None:
        self._writer.close()


class ForwardedConnection(SocketConnection):
    """A control connection that another program passes on: the process of the component is not at the other end."""

    @property
    def peer(self) -> int:
        return FORWARDED


class SocketFolder:
    """Implements :class:`midstride.wire.transport.Transport` in ``folder``, which :meth:`listen` creates."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def address(self, instance: str, seen_from: str | None = None) -> str:
        return f"{_SCHEME}{self._path(instance)}"

    def cut_lock(self, cut: str) -> FileLock:
        return FileLock(self.folder / _LOCKS, cut)

    def present(self) -> dict[str, str]:
        try:
            names = sorted(os.listdir(self.folder))
        except FileNotFoundError:
            return {}
        instances = [unquote(name.removesuffix(_SUFFIX)) for name in names if name.endswith(_SUFFIX)]
        return {instance: self.address(instance) for instance in instances}

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        path = self._path(instance)
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            allowed = {0, os.getuid(), self.folder.stat().st_uid}
            async with locked(self.folder):
                if _answers(path):
                    raise NodeError(
                        f"a component {instance} is running already in {self.folder.parent.name}; end it, or give "
                        "this one another name"
                    )
                listening = self._bind(path)
                inode = path.stat().st_ino
        except OSError as error:
            raise NodeError(f"cannot open the control socket {path}: {error.strerror or error}") from None

        async def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                if _credentials(writer.get_extra_info("socket"))[1] in allowed:
                    await serve(SocketConnection(reader, writer))
            except asyncio.CancelledError:
                pass  # the component ends
            finally:
                writer.close()

        server = await asyncio.start_unix_server(accepted, sock=listening, limit=LONGEST_FRAME, **_KEEPING_THE_FILE)

        def stop() -> None:
            with contextlib.suppress(OSError):
                if path.stat().st_ino == inode:  # as long as this one listens, no other takes the name
                    path.unlink()
            server.close()

        return stop

    def _bind(self, path: Path) -> socket.socket:
        """A socket that listens at ``path``, in place of what a killed component has left there."""
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        new = self.folder / f".{uuid.uuid4().hex}"
        try:
            with short_name(self.folder) as folder:
                listening.bind(f"{folder}/{new.name}")
            new.chmod(0o600 if stat.S_IMODE(self.folder.stat().st_mode) == 0o700 else 0o660)
            listening.listen(_BACKLOG)
            new.rename(path)  # so whatever is found there under its name listens, or is dead
        except OSError:
            listening.close()
            new.unlink(missing_ok=True)
            raise
        return listening

    async def connect(self, address: str) -> SocketConnection:
        if (other := OtherHostAddress.read(address)) is not None:
            return await connect_to_other_host(other)
        return SocketConnection(*await open_socket(Path(address.removeprefix(_SCHEME)), address))

    def _path(self, instance: str) -> Path:
        return self.folder / f"{quote(instance.strip('/'), safe='')}{_SUFFIX}"


async def open_socket(path: Path, name: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection to the socket at ``path``, which an error calls ``name``.

    Raises Unreachable where nothing listens there; CallTimeout where that cannot be told within ``CONNECT_TIMEOUT``, as
    too many connections wait to be accepted, or no descriptor is left.
    """
    deadline = time.monotonic() + CONNECT_TIMEOUT
    while True:
        try:
            return await _open_at_once(path)
        except BlockingIOError:
            why = f"{name} accepts no connection: its process is stopped or overloaded"
        except OSError as error:
            if error.errno not in _SHORTAGES:
                raise Unreachable(f"nothing listens at {name}: {error.strerror or error}") from None
            why = f"{name} cannot be reached from here: {error.strerror}"
        if time.monotonic() >= deadline:
            raise CallTimeout(why)
        await asyncio.sleep(_CONNECT_INTERVAL)


async def connect_to_other_host(address: OtherHostAddress) -> ForwardedConnection:
    """Raises as :func:`midstride.wire.other_hosts.introduce`."""
    try:
        reader, writer = await open_socket(address.socket, str(address))
    except Unreachable as error:  # of the way: the component may listen
        raise CallTimeout(f"the way to {address.instance} on its host is not open: {error}") from None
    try:
        await introduce(reader, writer, address)
    except BaseException:
        writer.close()
        raise
    return ForwardedConnection(reader, writer)


def _answers(path: Path) -> bool:
    """Return whether something listens at ``path``: the socket file may be left over from a killed process."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            _connect(probe, path)
        except OSError as error:
            return error.errno in (errno.EAGAIN, errno.EACCES)
        return True


async def _open_at_once(path: Path) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection. Raises as :func:`_connect`."""
    connecting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        _connect(connecting, path)
        return await asyncio.open_unix_connection(sock=connecting, limit=LONGEST_FRAME)
    except BaseException:
        connecting.close()
        raise


def _connect(connecting: socket.socket, path: Path) -> None:
    """Connect at once or not at all: BlockingIOError where too many wait to be accepted. Raises OSError."""
    connecting.setblocking(False)
    with short_name(path) as short:
        connecting.connect(short)


@contextlib.contextmanager
def short_name(path: Path) -> Iterator[str]:
    """A name of ``path`` that is no longer than a socket's may be, valid within the block. Raises OSError."""
    descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}"
    finally:
        os.close(descriptor)


@contextlib.asynccontextmanager
async def locked(folder: Path) -> AsyncIterator[None]:
    """Take names in ``folder`` one process at a time: of two that start at once under one name, one is refused.

    Raises NodeError where another process keeps the lock.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        deadline = time.monotonic() + LOCK_TIMEOUT
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise NodeError(
                        f"another process holds the lock of {folder}: a component that was stopped while it started?"
                    ) from None
            await asyncio.sleep(0.01)
        yield
    finally:
        os.close(descriptor)


def _credentials(connection: socket.socket) -> tuple[int, int]:
    """The process and the user at the other end, as the kernel knows them."""
    pid, uid, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return pid, uid
