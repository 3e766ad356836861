"""Locks of cuts: each is a locked byte of one file beside the sockets, which the kernel frees as its process ends."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import struct
import threading
from functools import cache
from pathlib import Path

# How a lock is refused that another open file description holds.
_HELD = (errno.EAGAIN, errno.EACCES)
# The kernel's struct flock.
_FLOCK = "hhqqi4x"


class FileLock:
    """Implements :class:`midstride.wire.transport.CutLock`: a lock of the byte of ``path`` that ``cut`` is hashed to.

    The lock is that of an open file description, so both sides of a cut may be in one process. The file stays open once
    it is used: were it removed and made again, the other side's lock would be in another file.
    """

    def __init__(self, path: Path, cut: str) -> None:
        self._path = path
        self._byte = int.from_bytes(hashlib.blake2b(cut.encode(), digest_size=7).digest(), "big")
        self._descriptor: int | None = None
        self._held = self._renounced = self._shared = False
        self._holder = 0  # the process that holds it
        self._mutex = threading.Lock()

    def take(self) -> bool:
        with self._mutex:
            return self._held or (not self._renounced and self._take())

    def renounce(self) -> bool:
        with self._mutex:
            self._renounced = not self._held
            return self._renounced

    def give_back(self) -> None:
        with self._mutex:
            held, self._held = self._held, False
            if self._descriptor is not None:
                if held and self._holder == os.getpid():  # a child that user code has forked keeps the file open, too
                    self._lock(fcntl.F_UNLCK)
                os.close(self._descriptor)
                self._descriptor = None

    __del__ = give_back

    @property
    def is_taken(self) -> bool:
        with self._mutex:
            if self._held or not self._open():
                return False
            found: int = struct.unpack(_FLOCK, self._request(fcntl.F_OFD_GETLK, fcntl.F_WRLCK))[0]
            return found != fcntl.F_UNLCK

    @property
    def place(self) -> str:
        with self._mutex:
            return self._place()

    def share(self, place: str) -> None:
        with self._mutex:
            self._shared = self._shared or (place != "" and place == self._place())

    def take_freed(self) -> bool:
        return self._shared and self.take()

    def _take(self) -> bool:
        if not self._open():
            return False
        try:
            self._lock(fcntl.F_WRLCK)
            self._held, self._holder = True, os.getpid()
        except OSError as error:
            self._shared = self._shared or error.errno in _HELD
        return self._held

    def _lock(self, kind: int) -> None:
        """Lock or unlock the byte. Raises OSError."""
        self._request(fcntl.F_OFD_SETLK, kind)

    def _request(self, request: int, kind: int) -> bytes:
        """Make a request about a lock of the byte; what the kernel replies. Raises OSError."""
        assert self._descriptor is not None
        lock = struct.pack(_FLOCK, kind, os.SEEK_SET, self._byte, 1, 0)
        return fcntl.fcntl(self._descriptor, request, lock)

    def _open(self) -> bool:
        """Return whether the file can be used."""
        if self._descriptor is None:
            try:
                self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            except OSError:
                return False
            with contextlib.suppress(PermissionError):  # its creator lets the other users of the folder use it
                os.fchmod(self._descriptor, 0o666)
        return True

    def _place(self) -> str:
        kernel = _kernel()
        if not kernel or not self._open():
            return ""
        assert self._descriptor is not None
        file = os.fstat(self._descriptor)
        return f"{kernel} {file.st_dev} {file.st_ino}"


@cache
def _kernel() -> str:
    """The kernel that runs here, as hosts may have files of the same numbers; empty where it is not known."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""
