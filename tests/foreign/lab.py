"""Plain processes behind gates: instead of librcl, they are linked with a library that keeps a log."""

from __future__ import annotations

import mmap
import os
import struct
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from midstride.codec.component_form import NamedComponentForm
from midstride.foreign.page import Page
from midstride.foreign.page_layout import OPEN, OUTPUT, PagePort, PortFlag
from midstride.foreign.record import ForeignRecord
from midstride.model.component import ComponentSpec
from midstride.node.handover.baton import BatonWord

MS = 1_000_000
RECORD = struct.Struct("QQq")
LOG_SIZE = 16 + 4_000_000 * RECORD.size


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.002)


def variables(page: Path, programs: Path, library: Path, log: Path, index: int | str) -> dict[str, str]:
    """Have the process of a node use the gate of ``index`` in ``page``, and write to ``log``."""
    return {
        "LD_PRELOAD": str(library),
        "LD_LIBRARY_PATH": str(programs),
        "FAKE_LOG": str(log),
        "MIDSTRIDE_GATE_PAGE": str(page),
        "MIDSTRIDE_GATE_NODE": str(index),
    }


class Lab:
    """Nodes that publish on one topic behind their gates."""

    def __init__(self, folder: Path, programs: Path, library: Path) -> None:
        self.page = Page(folder / "page", library)
        self.programs, self.library = programs, library
        self.log = folder / "log"
        self.log.touch()
        os.truncate(self.log, LOG_SIZE)
        with open(self.log, "r+b") as file:
            self.memory = mmap.mmap(file.fileno(), LOG_SIZE)
        self.processes: dict[int, subprocess.Popen[bytes]] = {}

    def node(self, period: int, flags: PortFlag, *, baton: int = 0, messages: int = 10**12) -> int:
        """Start a node, with an open gate if it is to share a baton; its index."""
        index = self.page.allocate(f"node_{len(self.processes)}")
        self.page.set_ports(index, [("/chat", OUTPUT)])
        port = self.port(index)
        port.flags, port.baton = flags, baton or self.page.new_baton(index)
        port.gate = OPEN if baton else 0
        self.run(index, period, messages)
        return index

    def run(self, index: int, period: int, messages: int, *takes: str) -> None:
        """Start the process of a node, which may take messages from a topic, and wait until it has joined."""
        self.start(index, "/chat", str(period), str(messages), *takes)
        until(
            lambda: any(port.endpoints and port.tried for port in self.page.ports(index)[:1]),
            f"node {index} has not written",
        )

    def start(self, index: int, *arguments: str) -> None:
        given = variables(self.page.path, self.programs, self.library, self.log, index)
        self.processes[index] = self.start_process(given, str(index + 1), *arguments)

    def start_process(self, given: Mapping[str, str], *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen([self.programs / "node", *arguments], env={**os.environ, **given})

    def record(self, instance: str, index: int, component: ComponentSpec) -> None:
        """Write the record of a node beside the page, as the manager that has started it does."""
        ForeignRecord(
            instance=instance,
            node=f"/{instance}",
            token="",
            uuid="",
            pid=self.processes[index].pid,
            started=time.time_ns(),
            declaration=NamedComponentForm.of(component),
            index=index,
            topics={},
            modes={},
        ).write(self.page.path.parent)

    def port(self, index: int) -> PagePort:
        port: PagePort = self.page.ports(index)[0]
        return port

    def word(self, baton: int) -> BatonWord:
        return self.page.word(baton)

    def count(self) -> int:
        return int(struct.unpack_from("Q", self.memory)[0])

    def overlaps(self) -> int:
        return int(struct.unpack_from("I", self.memory, 12)[0])

    def records(self) -> list[tuple[int, int, int]]:
        """Writer, number and time of each message, in the order of publication; of one that was killed, if complete."""
        rows = (RECORD.unpack_from(self.memory, 16 + index * RECORD.size) for index in range(self.count()))
        return [row for row in rows if all(row)]

    def written_by(self, index: int) -> int:
        return int(self.port(index).passed)

    def kill(self, index: int) -> None:
        self.processes[index].kill()
        self.processes[index].wait()

    def close(self) -> None:
        for process in self.processes.values():
            process.kill()
            process.wait()
            for pipe in filter(None, (process.stdin, process.stdout)):
                pipe.close()
