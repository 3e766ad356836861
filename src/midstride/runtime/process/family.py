"""Which processes belong to a component: those of its group, what they have started, and orphans that bear its mark.

A program may start others in sessions of their own, as `setsid` and daemons do, which no signal to its process group
reaches. Two things show that such a process belongs to it: a chain of parents, and the names of the system and of the
instance in its environment, which also an orphan has, and which a later manager can read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import ProcessInfo
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN


class ProcessMark(NamedTuple):
    """What the environment of a component's processes says: the token of its system, and its instance."""

    token: str
    instance: str

    @classmethod
    def of(cls, pid: int) -> ProcessMark | None:
        """None where the process has none, or its environment cannot be read."""
        token, instance = (reaper.environment_value(pid, name) for name in (ENV_TOKEN, ENV_INSTANCE))
        # A spare process has blanks in place of a name until it is given one.
        return None if not token or instance is None or not instance.strip() else cls(token, instance.strip())


# The marks that have been read: an environment is that with which a process has started.
_marks: Final[dict[tuple[int, float], ProcessMark | None]] = {}


def _mark(process: ProcessInfo) -> ProcessMark | None:
    key = process.pid, process.started
    if key not in _marks:
        _marks[key] = ProcessMark.of(process.pid)
    return _marks[key]


def members(leader: ProcessInfo, mark: ProcessMark | None, known: Mapping[int, float]) -> dict[int, ProcessInfo]:
    """The living processes that belong to ``leader``, itself included, by number.

    ``known``: those that belonged to it before, number and start; a chain of parents breaks when one of them exits.
    """
    found = {process.pid: process for process in reaper.processes()}
    for key in [key for key in _marks if (seen := found.get(key[0])) is None or seen.started != key[1]]:
        del _marks[key]
    belonging: dict[int, ProcessInfo] = {}
    children: dict[int, list[ProcessInfo]] = {}
    for process in found.values():
        children.setdefault(process.parent, []).append(process)
        if (
            (process.pid, process.started) == (leader.pid, leader.started)
            or (process.group == leader.group == leader.pid and process.started >= leader.started)
            or known.get(process.pid) == process.started
            or (mark is not None and process.started >= leader.started and _mark(process) == mark)
        ):
            belonging[process.pid] = process
    pending = list(belonging.values())
    while pending:
        for child in children.get(pending.pop().pid, ()):
            if child.pid not in belonging:
                belonging[child.pid] = child
                pending.append(child)
    return {pid: process for pid, process in belonging.items() if process.alive}
