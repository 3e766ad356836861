"""Claims of cuts between processes: byte locks of one file beside the sockets, which the kernel frees when one ends."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import struct
import threading
from pathlib import Path


class FileClaim:
    """Implements :class:`midstride.wire.transport.CutClaim`: a lock of the byte of ``path`` that ``cut`` is hashed to.

    The lock is that of an open file description, so both sides of a cut may be in one process.
    """

    def __init__(self, path: Path, cut: str) -> None:
        self._path = path
        self._byte = int.from_bytes(hashlib.blake2b(cut.encode(), digest_size=7).digest(), "big")
        self._descriptor: int | None = None
        self._renounced = False
        self._turn = threading.Lock()

    def take(self) -> bool:
        with self._turn:
            if self._descriptor is None and not self._renounced:
                self._descriptor = self._locked()
            return self._descriptor is not None

    def renounce(self) -> bool:
        with self._turn:
            self._renounced = self._descriptor is None
            return self._renounced

    def give_back(self) -> None:
        with self._turn:
            if self._descriptor is not None:
                os.close(self._descriptor)
                self._descriptor = None

    __del__ = give_back

    def _locked(self) -> int | None:
        """The descriptor that holds the lock; None where another one does, or the file cannot be used."""
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:
            return None
        with contextlib.suppress(PermissionError):  # its creator lets the other users of the folder use it
            os.fchmod(descriptor, 0o666)
        try:
            lock = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, self._byte, 1, 0)
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, lock)
        except OSError:
            os.close(descriptor)
            return None
        return descriptor
