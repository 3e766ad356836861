"""The manager's view of the page of shared memory in which gates and batons are: the layout is that of ``baton.h``.

Each step with a baton is one compare-and-swap, made by the functions of the library itself.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import time
from collections.abc import Sequence
from ctypes import c_char, c_int, c_int64, c_uint32, c_uint64
from enum import IntFlag
from pathlib import Path
from typing import Any, Final

from midstride.errors import BackendError
from midstride.node.handover.baton import BatonStep, BatonWord

MAGIC: Final = 0x4D4944535452444E
VERSION: Final = 1
NODES: Final = 128
PORTS: Final = 32
NAME: Final = 256

# The folder beside the control sockets with the records of the nodes and this file.
GATES_FOLDER: Final = "gates"
PAGE: Final = "page"

UNUSED, OUTPUT, INPUT = range(3)
CLOSED, OPEN = range(2)
# Of a node, in `used`. LISTS: the library adds a port for each of its topics, with an open gate.
IN_USE, LISTS = 1, 2

# A node that no process has joined as for so long (s) may be given to another: its manager had been killed meanwhile.
JOINED_WITHIN: Final = 60


class PortFlag(IntFlag):
    """RATED: its writes are slots. LAYS: the baton is laid down after one. TIMED: no port that shares it is rated.

    KEEPS: of what is written behind the gate, the last message is kept, and published when the gate lets it pass.
    SHUT: an input that a probe closes, as long as the lease of the page lasts.
    """

    RATED = 1
    LAYS = 2
    TIMED = 4
    KEEPS = 8
    SHUT = 16


class PagePort(ctypes.Structure):
    _fields_ = [
        ("direction", c_uint32),
        ("flags", c_uint32),
        ("gate", c_uint32),
        ("baton", c_uint32),
        ("passed", c_uint64),
        ("gated", c_uint64),
        ("last", c_int64),
        ("tried", c_int64),
        ("endpoints", c_uint32),
        ("matched", c_uint32),
        ("kept", c_uint32),
        ("half", c_uint32),
        ("topic", c_char * NAME),
    ]


class PageNode(ctypes.Structure):
    _fields_ = [
        ("pid", c_uint32),
        ("bell", c_uint32),
        ("beat", c_uint32),
        ("used", c_uint32),
        ("instance", c_char * NAME),
        ("ports", PagePort * PORTS),
    ]


class PageBaton(ctypes.Structure):
    _fields_ = [
        ("word", c_uint64),
        ("laid", c_int64),
        ("patience", c_int64),
        ("collisions", c_uint64),
        ("padding", c_uint64 * 4),
    ]


class PageLayout(ctypes.Structure):
    _fields_ = [
        ("magic", c_uint64),
        ("version", c_uint32),
        ("size", c_uint32),
        ("lease", c_int64),
        ("padding", c_uint64 * 5),
        ("batons", PageBaton * NODES),
        ("nodes", PageNode * NODES),
    ]


def load_library(path: Path) -> Any:
    """The functions of the library that the manager calls."""
    library = ctypes.CDLL(str(path), mode=os.RTLD_LOCAL | os.RTLD_NOW)
    library.midstride_enter.argtypes = [
        c_uint64,
        c_uint32,
        c_uint32,
        c_int,
        c_int,
        c_int,
        ctypes.POINTER(c_uint64),
    ]
    library.midstride_leave.argtypes = [c_uint64, c_uint64, c_uint32, c_int]
    library.midstride_leave.restype = c_uint64
    library.midstride_step.argtypes = [c_uint64, c_int, c_uint32, c_uint32, c_int]
    library.midstride_step.restype = c_uint64
    library.midstride_take_step.argtypes = [ctypes.POINTER(PageBaton), c_int, c_uint32, c_uint32, c_int]
    library.midstride_take_step.restype = c_uint64
    library.midstride_is_dead.argtypes = [c_int, c_uint32]
    library.midstride_ring.argtypes = [ctypes.POINTER(PageNode)]
    library.midstride_ring.restype = None
    return library


class Page:
    """The page at ``path``, created if need be. One manager writes to it at a time. Raises BackendError."""

    def __init__(self, path: Path, library: Path) -> None:
        self.path, self.library_path = path, library
        self._library = load_library(library)
        size = ctypes.sizeof(PageLayout)
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fresh = os.fstat(self._file).st_size == 0
            if fresh:
                self._reserve(size)
            if os.fstat(self._file).st_size < size:
                raise BackendError(f"{path} is not the page of this version of Midstride; run `midstride down` first")
            self._memory = mmap.mmap(self._file, size)
        except OSError as error:
            raise BackendError(f"the page of the gates, {path}, cannot be used: {error.strerror or error}") from None
        self.layout = PageLayout.from_buffer(self._memory)
        if fresh:
            self.layout.size, self.layout.version, self.layout.magic = size, VERSION, MAGIC
        elif (self.layout.magic, self.layout.version, self.layout.size) != (MAGIC, VERSION, size):
            raise BackendError(f"{path} is the page of another version of Midstride; run `midstride down` first")

    def _reserve(self, size: int) -> None:
        """Now: a process that writes where the disk has no space left by then is killed (SIGBUS). Raises OSError."""
        try:
            os.posix_fallocate(self._file, 0, size)
        except OSError:
            os.ftruncate(self._file, 0)  # the next one begins anew
            raise

    def allocate(self, instance: str) -> int:
        """The index of an unused node, which now is that of ``instance``. Raises BackendError where all are used."""
        now = int(time.monotonic())

        def use(index: int) -> int:
            node = self.layout.nodes[index]
            if not node.used:
                return 0
            if node.pid:  # a manager that was killed has not freed what its nodes had
                return 1 if self.is_dead(index) else 3
            return 3 if 0 <= now - node.beat < JOINED_WITHIN else 2

        least, index = min((use(index), index) for index in range(NODES))
        if least == 3:
            raise BackendError(f"more than {NODES} nodes have a gate")
        node = self.layout.nodes[index]
        ctypes.memset(ctypes.addressof(node), 0, ctypes.sizeof(node))
        node.instance, node.beat, node.used = instance.encode()[: NAME - 1], now, IN_USE
        return index

    def index_of(self, instance: str) -> int | None:
        """The index of the node of ``instance``; of one that lives, as a broken-off hand-over may leave another."""
        name = instance.encode()[: NAME - 1]
        found = [index for index, node in enumerate(self.layout.nodes) if node.used and node.instance == name]
        return min(found, key=lambda index: not self._lives(index), default=None)

    def free(self, index: int) -> None:
        self.layout.nodes[index].used = 0

    def set_ports(self, index: int, topics: Sequence[tuple[str, int]]) -> None:
        """The topics of a node, each with OUTPUT or INPUT; closed. Raises BackendError where there are too many."""
        if len(topics) > PORTS or any(len(topic.encode()) >= NAME for topic, _ in topics):
            raise BackendError(f"a node with a gate has at most {PORTS} ports, of at most {NAME - 1} bytes each")
        for entry, (topic, direction) in zip(self.layout.nodes[index].ports, topics, strict=False):
            entry.topic, entry.direction = topic.encode(), direction

    def new_baton(self, holder: int) -> int:
        """The index + 1 of a baton that no port of a node in use has; the node ``holder`` (index) holds it."""
        used = {port.baton for node in self.layout.nodes if node.used for port in node.ports}
        number = next(number for number in range(1, NODES + 1) if number not in used)
        self.step(number, BatonStep.GIVE, holder)
        return number

    def word(self, baton: int) -> BatonWord:
        return BatonWord.of(self.layout.batons[baton - 1].word)

    def step(self, baton: int, step: BatonStep, node: int, successor: int = -1, at_once: bool = False) -> BatonWord:
        """Take ``step``; the word before. ``node`` and ``successor`` are indices."""
        entry = self.layout.batons[baton - 1]
        return BatonWord.of(
            self._library.midstride_take_step(ctypes.byref(entry), step, node + 1, successor + 1, at_once)
        )

    def silence(self, topic: str) -> float | None:
        """For how long no node that may publish on ``topic`` has written (s); None where none may, or has ever."""
        name, last = topic.encode(), 0
        for index, node in enumerate(self.layout.nodes):
            for port in node.ports if node.used else ():
                if (port.direction, port.gate, port.topic) == (OUTPUT, OPEN, name) and (
                    not port.baton or self.word(port.baton).holder == index + 1
                ):
                    last = max(last, port.tried)
        return max(0, time.monotonic_ns() - last) / 1e9 if last else None

    def is_dead(self, index: int) -> bool:
        """Whether the process that has joined as this node has ended."""
        node = self.layout.nodes[index]
        return bool(node.pid) and bool(self._library.midstride_is_dead(self._file, index + 1))

    def _lives(self, index: int) -> bool:
        return bool(self.layout.nodes[index].pid) and not self.is_dead(index)

    def ring(self, index: int) -> None:
        """Have the helper thread of a node look at once."""
        self._library.midstride_ring(ctypes.byref(self.layout.nodes[index]))
