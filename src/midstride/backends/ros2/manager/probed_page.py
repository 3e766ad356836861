"""The gates of running nodes, for `midstride capture --probe`: from a process that is not their manager.

An input is closed by a flag that counts only until the lease in the page ends, and that is renewed all the time. So if
this process ends in any way, or is stopped, the input is open again after LEASE at the latest.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from midstride.capture.probe import Count, ProbedPort
from midstride.errors import BackendError
from midstride.foreign import build
from midstride.foreign.gates import total
from midstride.foreign.page import PAGE, Page
from midstride.foreign.page_layout import OUTPUT, PagePort, PortFlag
from midstride.foreign.record import ForeignRecord

LEASE: Final = 2.0
# How often the counters are read, and the lease is renewed (s).
EVERY: Final = 0.01


class ProbedPage:
    """The gates of the nodes whose page and records are in ``folder``. Make one by :func:`probing`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._page = Page(folder / PAGE, build.library())
        self._nodes = {
            record.index: (record.node, record.instance)
            for record in ForeignRecord.all(folder)
            if record.index is not None
        }
        for port in self._page.every_port():
            port.flags &= ~PortFlag.SHUT
        self._lease = 0

    def ports(self) -> set[ProbedPort]:
        return set(self._entries())

    def _entries(self) -> dict[ProbedPort, tuple[int, PagePort]]:
        """With the process of each."""
        found = {}
        for index, (name, instance) in self._nodes.items():
            node = self._page.layout.nodes[index]
            if node.used and node.instance == instance.encode() and node.pid and not self._page.is_dead(index):
                for entry in self._page.ports(index):
                    found[ProbedPort(name, entry.topic.decode(), entry.kind == OUTPUT)] = int(node.pid), entry
        return found

    def watch(self, closed: ProbedPort | None, settling: float, counting: float) -> Mapping[ProbedPort, Count]:
        """See :class:`midstride.capture.probe.ProbedGates`. Raises BackendError if this process was stopped."""
        entries = self._entries()
        shut = entries[closed][1] if closed in entries else None
        self._lease = 0
        try:
            self._renew()
            before = 0 if shut is None else int(shut.gated)
            if shut is not None:
                shut.flags |= PortFlag.SHUT
            self._wait(settling)
            counters = {port: _Counter(entry) for port, (_, entry) in entries.items()}
            self._wait(counting, counters)
            lived = {port for port, (pid, _) in self._entries().items() if entries.get(port, (0,))[0] == pid}
            found = {port: counter.count() for port, counter in counters.items() if port in lived}
            if closed in found and shut is not None:  # in a loop, it may receive nothing after the first moment
                found[closed] = replace(found[closed], held=int(shut.gated) - before)
            return found
        finally:
            if shut is not None:
                shut.flags &= ~PortFlag.SHUT

    def _wait(self, seconds: float, counters: Mapping[ProbedPort, _Counter] | None = None) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(EVERY, left))
            self._renew()
            for counter in (counters or {}).values():
                counter.look()

    def _renew(self) -> None:
        now = time.monotonic_ns()
        if self._lease and now > self._lease:
            raise BackendError(
                f"the probe was stopped for more than {LEASE:g} s, and its input opened by itself; retry"
            )
        self._lease = self._page.layout.lease = now + int(LEASE * 1e9)


class _Counter:
    """A counter of the messages that pass a port from now on."""

    def __init__(self, entry: PagePort) -> None:
        self._entry = entry
        self._total, self._passed = total(entry), int(entry.passed)
        self._last, self._longest = time.monotonic_ns(), 0

    def look(self) -> None:
        if (tried := int(self._entry.tried)) > self._last:
            self._longest, self._last = max(self._longest, tried - self._last), tried

    def count(self) -> Count:
        """An output counts as written where its own gate is closed, too, and where it stays within the process."""
        longest = max(self._longest, time.monotonic_ns() - self._last) / 1e9
        if self._entry.kind == OUTPUT:
            return Count(total(self._entry) - self._total, longest=longest)
        return Count(int(self._entry.passed) - self._passed, longest=longest)


@contextmanager
def probing(folder: Path) -> Iterator[ProbedPage]:
    """The gates of a system, for one probe at a time. Raises BackendError where there are none, or one is probing."""
    path = folder / PAGE
    try:
        lock = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        raise BackendError(
            "no node has a gate, and inputs can be closed there only: start the nodes by `midstride up`, "
            "with `gate preload`"
        ) from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BackendError("another `midstride capture --probe` is running") from None
        yield ProbedPage(folder)
    finally:
        os.close(lock)
