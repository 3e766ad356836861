"""The logs of components on other hosts, copied below the system's folder of logs as far as they are asked for.

The manager's links forward the socket of each host process to this host: it is asked there for what is new. So `logs`
reads and follows them like any other, and nothing is copied while nobody looks. Each host has a folder for itself: an
instance here may have the name of an earlier one there, and its log is not to be taken for the copy.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final, TypeVar

import msgspec

from midstride.errors import BackendError, ProtocolError
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.workspace import Workspace
from midstride.wire.frames import INVALID
from midstride.wire.sockets import short_name

T = TypeVar("T")

# How long a host process may take to answer (s), and the longest piece that is asked for (bytes).
ANSWER_SECONDS: Final = 3.0
LONGEST_PIECE: Final = 1024 * 1024
# The names of logs as :func:`midstride.model.instance_names.log_file_name` makes them.
_NAME: Final = re.compile(r"[A-Za-z0-9_.~-]+\.log")


@dataclass
class RemoteLogs:
    """``wanted``: whether a log of this name, without its suffix, is to be copied. Used in one thread."""

    workspace: Workspace
    wanted: Callable[[str], bool]
    problems: dict[str, str] = field(default_factory=dict)  # by host: why its logs could not be read
    _readers: dict[str, _Reader] = field(default_factory=dict)

    def refresh(self) -> None:
        """Copy what has been written since; a host that does not answer is left out, and in ``problems``."""
        for path in sorted(self.workspace.path.glob("hosts/*.sock")):
            host = path.stem
            try:
                reader = self._readers.get(host)
                if reader is None:
                    reader = self._readers[host] = _Reader.open(path)
                self._copy(reader, self.workspace.logs / host)
                self.problems.pop(host, None)
            except (OSError, BackendError) as error:
                self.problems[host] = str(error) or type(error).__name__
                if (failed := self._readers.pop(host, None)) is not None:
                    failed.close()

    def _copy(self, reader: _Reader, folder: Path) -> None:
        for name, length in reader.call(calls.ListLogs(), dict[str, int]).items():
            if not _NAME.fullmatch(name) or name in ("manager.log", "host.log") or not self.wanted(Path(name).stem):
                continue
            path = folder / name
            folder.mkdir(exist_ok=True)
            have = path.stat().st_size if path.exists() else 0
            if have > length:  # it was shortened there
                path.unlink()
                have = 0
            while have < length:
                call = calls.ReadLog(file=name, begin=have, longest=LONGEST_PIECE)
                piece = reader.call(call, calls.LogPiece).content
                if not piece:
                    break
                with path.open("ab") as file:
                    file.write(piece)
                have += len(piece)

    def close(self) -> None:
        for reader in self._readers.values():
            reader.close()
        self._readers.clear()


@dataclass
class _Reader:
    """A connection that reads, to one host process."""

    connection: socket.socket
    file: BinaryIO
    number: int = 0

    @classmethod
    def open(cls, path: Path) -> _Reader:
        """Raises OSError, ProtocolError."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(ANSWER_SECONDS)
            with short_name(path) as name:
                connection.connect(name)
            reader = cls(connection, connection.makefile("rb"))
            frames.decode_greeting(reader.line())
            reader.send(frames.ReaderHello(protocol=frames.HOST_PROTOCOL))
            reader.line()
        except BaseException:
            connection.close()
            raise
        return reader

    def line(self) -> bytes:
        line = self.file.readline(frames.LONGEST_HOST_FRAME)
        if not line.endswith(b"\n"):
            raise ProtocolError("the connection to its host process has ended")
        return line[:-1]

    def send(self, frame: frames.FromManager) -> None:
        self.connection.sendall(frames.encode(frame) + b"\n")

    def call(self, call: calls.HostCall, result: type[T]) -> T:
        self.number += 1
        self.send(frames.CallFrame(number=self.number, call=call))
        while True:
            frame = frames.decode_from_host(self.line())
            if isinstance(frame, frames.ResultFrame) and frame.number == self.number:
                break
        if frame.failed is not None:
            raise BackendError(frame.failed)
        try:
            return msgspec.json.decode(frame.result, type=result)
        except INVALID as error:
            raise ProtocolError(f"its host process has answered with something else: {error}") from None

    def close(self) -> None:
        self.file.close()
        self.connection.close()
