"""Unix sockets, one for each component, in the folder ``components`` of the system's workspace.

The folder is the access control: mode 0700 unless its owner opens it to others. A component accepts connections of
its own user, of root, and of the user who owns the folder. A path too long for a socket (107 bytes on Linux) is
reached through a file descriptor of the folder, so its length does not matter.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import socket
import stat
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final
from urllib.parse import quote, unquote

from midstride.errors import ManagerError, NodeError, ProtocolError, Unreachable
from midstride.wire.frames import LONGEST_FRAME
from midstride.wire.transport import Serve

# The folder of the control sockets in a workspace.
COMPONENTS: Final = "components"
_SCHEME: Final = "unix:"
_SUFFIX: Final = ".sock"
_BACKLOG: Final = 16
# How long another listener of the same name may take to be found out (s).
_LOOK: Final = 1.0
_SYSTEM: Final = re.compile(r"[A-Za-z][A-Za-z0-9_\-]*\Z")


def workspace_root() -> Path:
    """The folder of all workspaces of this user: ``$XDG_RUNTIME_DIR/midstride``, else one in the temporary folder."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "midstride"
    return Path(tempfile.gettempdir()) / f"midstride-{os.getuid()}"


def workspace_folder(system: str) -> Path:
    """The workspace of ``system``, created if need be.

    Raises ManagerError where ``system`` is not a name, or where the folder cannot be created or is another user's.
    """
    if not _SYSTEM.match(system):
        raise ManagerError(f"{system!r} cannot name a running system: use letters, digits, _ and -")
    root = workspace_root()
    for folder in (root, root / system):
        try:
            created = not folder.exists()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            info = folder.stat()
            if created or (info.st_uid == os.getuid() and stat.S_IMODE(info.st_mode) & 0o007):
                folder.chmod(0o700)
        except OSError as error:
            raise ManagerError(
                f"cannot create the folder {folder}, for sockets, state and logs: {error.strerror or error}; "
                "set XDG_RUNTIME_DIR to a folder of yours"
            ) from None
        if info.st_uid != os.getuid() and not stat.S_IMODE(info.st_mode) & 0o020:
            raise ManagerError(f"{folder} belongs to another user; remove it or set XDG_RUNTIME_DIR")
    return root / system


class SocketConnection:
    """Implements :class:`midstride.wire.transport.Connection`: a frame is a line."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    async def send(self, frame: bytes) -> None:
        try:
            self._writer.write(frame + b"\n")
            await self._writer.drain()
        except (OSError, RuntimeError) as error:  # RuntimeError: it was closed here
            raise Unreachable(f"the control connection is closed: {error}") from None

    async def receive(self) -> bytes | None:
        try:
            line = await self._reader.readline()
        except ValueError:
            raise ProtocolError(f"a frame of more than {LONGEST_FRAME} bytes") from None
        except OSError:
            return None
        return line[:-1] if line.endswith(b"\n") else None  # half a line: the other end died while it wrote

    def close(self) -> None:
        self._writer.close()


class SocketListener:
    """Implements :class:`midstride.wire.transport.Listener`."""

    def __init__(self, server: asyncio.AbstractServer, path: Path, inode: int) -> None:
        self._server = server
        self._path = path
        self._inode = inode

    def close(self) -> None:
        self._server.close()
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == self._inode:  # not that of a component that has taken the name since
                self._path.unlink()


class SocketFolder:
    """Implements :class:`midstride.wire.transport.Transport` in ``folder``, which :meth:`listen` creates."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def address(self, instance: str) -> str:
        return f"{_SCHEME}{self._path(instance)}"

    def present(self) -> dict[str, str]:
        try:
            names = sorted(os.listdir(self.folder))
        except FileNotFoundError:
            return {}
        instances = [unquote(name.removesuffix(_SUFFIX)) for name in names if name.endswith(_SUFFIX)]
        return {instance: self.address(instance) for instance in instances}

    async def listen(self, instance: str, serve: Serve) -> SocketListener:
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = self._path(instance)
        if await self._answers(path):
            raise NodeError(
                f"a component {instance} is running already in {self.folder.parent.name}; end it, or give this one "
                "another name"
            )
        allowed = {0, os.getuid(), self.folder.stat().st_uid}
        open_connections: set[asyncio.Task[None]] = set()

        async def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.current_task()
            assert task is not None
            open_connections.add(task)
            try:
                if _peer_uid(writer.get_extra_info("socket")) in allowed:
                    await serve(SocketConnection(reader, writer))
            except asyncio.CancelledError:
                pass  # the component ends
            finally:
                open_connections.discard(task)
                writer.close()

        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with contextlib.suppress(FileNotFoundError):
                path.unlink()  # of a component that was killed
            with _short(path) as short:
                listening.bind(short)
            os.chmod(path, 0o600 if stat.S_IMODE(self.folder.stat().st_mode) == 0o700 else 0o660)
            listening.listen(_BACKLOG)
            inode = path.stat().st_ino
        except OSError as error:
            listening.close()
            raise NodeError(f"cannot open the control socket {path}: {error.strerror or error}") from None
        server = await asyncio.start_unix_server(accepted, sock=listening, limit=LONGEST_FRAME)
        return SocketListener(server, path, inode)

    async def connect(self, address: str) -> SocketConnection:
        path = Path(address.removeprefix(_SCHEME))
        connecting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connecting.setblocking(False)
        try:
            with _short(path) as short:
                await asyncio.get_running_loop().sock_connect(connecting, short)
            reader, writer = await asyncio.open_unix_connection(sock=connecting, limit=LONGEST_FRAME)
        except OSError as error:
            connecting.close()
            raise Unreachable(f"nothing listens at {address}: {error.strerror or error}") from None
        except BaseException:
            connecting.close()
            raise
        return SocketConnection(reader, writer)

    async def _answers(self, path: Path) -> bool:
        """Whether something listens at ``path``: a socket file alone may be what a killed process left."""
        if not path.exists():
            return False
        probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        probe.settimeout(_LOOK)
        try:
            with _short(path) as short:
                probe.connect(short)
            return True
        except OSError as error:
            return error.errno in (errno.EAGAIN, errno.EACCES) or isinstance(error, TimeoutError)
        finally:
            probe.close()

    def _path(self, instance: str) -> Path:
        return self.folder / f"{quote(instance.strip('/'), safe='')}{_SUFFIX}"


@contextlib.contextmanager
def _short(path: Path) -> Iterator[str]:
    """A short name of ``path`` for the socket calls, which take 107 bytes and no more."""
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


def _peer_uid(connection: socket.socket) -> int:
    """The user at the other end, as the kernel knows it."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    _, uid, _ = struct.unpack("3i", credentials)
    return int(uid)
