"""The processes of component containers that several instances share: who is in each, and who is loaded when."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Container, Coroutine, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from midstride.errors import StartFailed
from midstride.foreign.record import ForeignRecord
from midstride.runtime.backend_protocol import Exited, Launch
from midstride.runtime.process.child_process import Process


@dataclass
class SharedProcess:
    """A process of the container ``name``. ``index``: its part in the page of the gates; None where it has none.

    ``members``: the instances that are in it, or are about to be loaded; ``leaving``: those that are being unloaded.
    ``loading``: held while it loads or unloads. ``loads``: the instance that it is asked to load now; empty: none.
    ``unanswered``: by instance, the nodes that it was asked to load, and has not said whether it has; these are no
    members. ``unloads``: by instance, what waits until a node is gone that it was asked to unload, and has not said
    whether it does; these are members. ``left``: by instance, the nodes that it has not unloaded, and that are to end
    with it, as all others are; these are leaving. ``tasks``: all that waits for a request.
    """

    name: str
    process: Process
    index: int | None
    members: set[str] = field(default_factory=set)
    leaving: set[str] = field(default_factory=set)
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    loads: str = ""
    unanswered: dict[str, ForeignRecord] = field(default_factory=dict)
    unloads: dict[str, asyncio.Task[None]] = field(default_factory=dict)
    left: dict[str, ForeignRecord] = field(default_factory=dict)
    tasks: set[asyncio.Task[None]] = field(default_factory=set)

    def why_busy(self, instance: str) -> str:
        """Say what follows from a request to load ``instance`` that is not answered, and what to do."""
        return (
            f"The constructor of {instance} may still run in {self.name}, into which no other node is loaded until it "
            f"has returned; it ends only with that process. `midstride restart {self.name}` moves the others to a new "
            f"one, and `kill -9 {self.process.pid}` ends all of them"
        )

    def why_unknown(self, instance: str, why: str) -> str:
        """Say that ``instance`` was asked to end, and may or may not; ``why``: what its container has not answered."""
        return (
            f"{instance} may still end in {self.name}, which has not answered; until then it is not known: {why}. With "
            "a gate, its timers, messages, requests and responses do not call it any more. It certainly ends with its "
            f"container, by `midstride restart {self.name}`, or when that is killed (process {self.process.pid})"
        )

    def why_it_goes_on(self, instance: str, why: str) -> str:
        """Say that ``instance`` has not ended; ``why``: what its container does not do."""
        return (
            f"{instance} goes on in {self.name}: {why}. It can only end with its container, by "
            f"`midstride restart {self.name}`, or when that is killed (process {self.process.pid})"
        )

    @property
    def is_stuck(self) -> bool:
        """True once it has not answered a request to load or unload a node, until it does."""
        return bool(self.unanswered or self.unloads or self.left)

    def why_left(self, instance: str) -> str:
        """Say that ``instance`` was to end with all others of the process, and is still in it."""
        return (
            f"{instance} is to end with {self.name}, which has not unloaded it. With a gate, its timers, messages, "
            f"requests and responses do not call it any more. `midstride restart {self.name}` ends that process, as "
            f"does `kill -9 {self.process.pid}`"
        )

    def hanging(self) -> Iterator[str]:
        """Yield which requests it has not answered in time, and what follows from each."""
        for instance in sorted(self.unanswered):
            yield f"{self.name} has not answered the request to load {instance}. {self.why_busy(instance)}"
        for instance in sorted(self.unloads):
            yield self.why_unknown(instance, "it was asked to unload it")
        for instance in sorted(self.left):
            yield self.why_left(instance)

    def wait_no_more(self, instance: str) -> None:
        """Nothing waits any more until ``instance`` is gone, where it was asked to unload that."""
        if (waits := self.unloads.pop(instance, None)) is not None:
            waits.cancel()

    def wait(self, until: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Have ``until`` run as long as this process does."""
        task = asyncio.get_running_loop().create_task(until)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)
        return task

    def require_answering(self, instance: str) -> None:
        """Raises StartFailed where a request to load a node is not answered."""
        for other in self.unanswered:
            raise StartFailed(f"{instance} cannot be loaded into {self.name}. {self.why_busy(other)}")

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
        words = f"{instance} ended with {self.name}, which {how}"
        if self.loads:
            words += f" while it was loading {'it' if self.loads == instance else self.loads}"
        return Exited(instance, self.process.status, self.process.last_words(), words, self.loads == instance)


class SharedProcesses:
    """The shared processes of one system, by name."""

    def __init__(self) -> None:
        self._known: dict[str, SharedProcess] = {}
        self._changing: dict[str, asyncio.Lock] = {}

    def __getitem__(self, name: str) -> SharedProcess:
        return self._known[name]

    def get(self, name: str) -> SharedProcess | None:
        return self._known.get(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def add(self, shared: SharedProcess) -> SharedProcess:
        self._known[shared.name] = shared
        return shared

    def remove(self, shared: SharedProcess) -> bool:
        """Forget a process that has ended; whether it was known."""
        if self._known.get(shared.name) is not shared:
            return False
        del self._known[shared.name]
        return True

    def of(self, instance: str) -> SharedProcess | None:
        """The process that an instance shares; None where it has one for itself, or is not known."""
        return next((each for each in self._known.values() if instance in {*each.members, *each.leaving}), None)

    def changing(self, name: str) -> asyncio.Lock:
        """Held while the process is started, which the first of its instances does, or ended with the last one."""
        return self._changing.setdefault(name, asyncio.Lock())

    def processes(self) -> list[SharedProcess]:
        return list(self._known.values())

    def is_unanswered(self, instance: str) -> bool:
        """Return whether the request to load ``instance`` is not answered: it ends with the process that was asked."""
        return any(instance in each.unanswered for each in self._known.values())

    def require_not_loading(self, launch: Launch) -> None:
        """Raises StartFailed where the node would run beside one of its role that a container may be about to have.

        But in a new process of that container, as then the other one is to end.
        """
        for shared in self._known.values():
            for other, record in shared.unanswered.items():
                if record.role == launch.role and launch.process in ("", shared.name):
                    raise StartFailed(f"{launch.instance} would be there twice. {shared.why_busy(other)}")
            for other, record in shared.left.items():
                if record.role == launch.role and launch.process in ("", shared.name):
                    raise StartFailed(f"{launch.instance} would be there twice. {shared.why_left(other)}")

    def close(self) -> None:
        """Nothing is waited for any more."""
        for shared in self._known.values():
            for task in shared.tasks:
                task.cancel()


@dataclass(frozen=True, slots=True)
class KnownNames:
    """The names that are in one of several containers of names."""

    parts: tuple[Container[str], ...]

    def __contains__(self, name: object) -> bool:
        return any(name in part for part in self.parts)
