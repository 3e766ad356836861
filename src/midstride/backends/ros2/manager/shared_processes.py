"""The processes of component containers that several instances share: who is in each, and who is loaded when."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from midstride.errors import StartFailed
from midstride.runtime.backend_protocol import Exited, Launch
from midstride.runtime.process.child_process import Process


@dataclass
class SharedProcess:
    """A process of the container ``name``. ``index``: its part in the page of the gates; None where it has none.

    ``members``: the instances that are in it, or are about to be loaded. ``loading``: held while it loads or unloads.
    """

    name: str
    process: Process
    index: int | None
    members: set[str] = field(default_factory=set)
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)

    def require_current(self, instance: str, library: Path) -> None:
        """Raises StartFailed where the file has changed since the process began, which may have loaded the old one."""
        begun = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME) + self.process.started
        try:
            changed = library.stat().st_ctime  # files of a package keep the times at which they were made
        except OSError:
            return
        if changed > begun:
            raise StartFailed(
                f"{instance} cannot be loaded into {self.name}: {library} has changed since that was started, and a "
                f"container never loads a library anew; `midstride restart {self.name}` moves all its nodes to a new "
                "process"
            )

    def left_by(self, instance: str, how: str) -> Exited:
        """Say that ``instance`` has ended with the process; ``how`` that has ended."""
        return Exited(
            instance, self.process.status, self.process.last_words(), f"{instance} ended with {self.name}, which {how}"
        )


class SharedProcesses:
    """The shared processes of one system, by name."""

    def __init__(self) -> None:
        self._known: dict[str, SharedProcess] = {}
        self._starting: dict[str, asyncio.Lock] = {}

    def __getitem__(self, name: str) -> SharedProcess:
        return self._known[name]

    def get(self, name: str) -> SharedProcess | None:
        return self._known.get(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def add(self, shared: SharedProcess) -> SharedProcess:
        self._known[shared.name] = shared
        return shared

    def remove(self, shared: SharedProcess) -> None:
        if self._known.get(shared.name) is shared:
            del self._known[shared.name]

    def of(self, instance: str) -> SharedProcess | None:
        """The process that an instance shares; None where it has one for itself, or is not known."""
        return next((each for each in self._known.values() if instance in each.members), None)

    def starting(self, launch: Launch) -> asyncio.Lock:
        """Held while the process is started that a launch is for: the first of its instances starts it."""
        return self._starting.setdefault(launch.process, asyncio.Lock())


@dataclass(frozen=True, slots=True)
class KnownNames:
    """The names that are in one of several containers of names."""

    parts: tuple[Container[str], ...]

    def __contains__(self, name: object) -> bool:
        return any(name in part for part in self.parts)
